"""The ensemble sampler: verdicts, walkers that settle, what it refuses, its seeds."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.inference.target import LogDensity
from targets import gaussian


def test_verdicts():
    short = si.sample(gaussian(), si.AIES(walkers=20, steps=200, ensembles=4), seed=1).verdict()
    assert not short.converged and "autocorrelation times" in str(short)
    long = si.sample(
        gaussian(), si.AIES(walkers=20, steps=8000, ensembles=4, differential_evolution=0.5), seed=1
    ).verdict()
    assert long.converged, str(long)
    single = si.sample(gaussian(), si.AIES(walkers=20, steps=8000, ensembles=1), seed=1).verdict()
    assert not single.converged and "single ensemble" in str(single)


def test_settling_frees_walkers_from_a_false_mode():
    """A narrow mode 200 nats below the true one catches walkers for ever; settling takes them out."""

    def density(x):
        true_mode = -0.5 * (x**2).sum(1)
        false_mode = -200.0 - 0.5 * (((x - 30.0) / 0.5) ** 2).sum(1)
        return np.logaddexp(true_mode, false_mode)

    def start(n, rng):
        x = rng.standard_normal((n, 2))
        x[::7] = 30.0 + 0.3 * rng.standard_normal((len(x[::7]), 2))
        return x

    target = LogDensity(density, "ab", start)
    settings = dict(walkers=14, steps=3000, ensembles=3, start_candidates=1, differential_evolution=0.0)
    assert si.sample(target, si.AIES(**settings, settling_steps=0), seed=1).verdict().stuck > 0
    assert si.sample(target, si.AIES(**settings, settling_steps=200), seed=1).verdict().stuck == 0
    with pytest.raises(InputError, match="discarded"):
        si.AIES(**settings, settling_steps=2000)


@pytest.mark.parametrize(
    "settings",
    [
        dict(walkers=7),
        dict(walkers=2),
        dict(steps=0),
        dict(stretch=1.0),
        dict(discard=1.0),
        dict(differential_evolution=2.0),
    ],
)
def test_bad_settings_are_refused(settings):
    with pytest.raises(InputError, match="AIES"):
        si.AIES(**settings)


def test_too_few_walkers_and_hopeless_starts():
    with pytest.raises(InputError, match="10 or more"):
        si.sample(gaussian(), si.AIES(walkers=8, steps=10), seed=1)
    never = LogDensity(lambda x: np.full(len(x), -np.inf), "ab", lambda n, rng: rng.standard_normal((n, 2)))
    with pytest.raises(si.StructidError, match="Check the priors"):
        si.sample(never, si.AIES(walkers=8, steps=10), seed=1)


def wide(dimension=4):
    """A Gaussian with correlations, a hundredth as wide as its prior."""
    rng = np.random.default_rng(3)
    factor = np.tril(rng.normal(size=(dimension, dimension))) + 2.0 * np.eye(dimension)
    space = si.ParameterSpace(**{f"x{i}": si.Normal(0.0, 100.0) for i in range(dimension)})
    return LogDensity(lambda x: -0.5 * ((x @ factor) ** 2).sum(axis=1), space.names, space)


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [2, 8])
def test_as_it_comes_it_converges_from_a_wide_prior(dimension):
    verdict = si.sample(wide(dimension), si.AIES(), seed=1).verdict()
    assert verdict.converged, str(verdict)


def test_a_short_run_as_it_comes_settles_only_in_what_is_discarded():
    assert si.AIES().settled_steps == 100 and si.AIES(steps=100).settled_steps == 0
    assert si.AIES(steps=240).settled_steps == 50
