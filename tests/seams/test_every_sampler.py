"""What every sampler keeps: moments within their own error, one seed one chain, killed and gone on with to the same bits.

A new sampler goes into `SAMPLERS`.
"""

import numpy as np
import pytest

import structid as si
from package import concrete_subclasses
from structid.core.errors import StoreMismatchError
from structid.inference.sampling.base import Sampler

NAMES = ("a", "b", "c")
COVARIANCE = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.3], [0.0, 0.3, 1.0]])
SPACE = si.ParameterSpace(**{n: si.Normal(0.0, 5.0) for n in NAMES})


def gaussian(shift=0.0):
    """Zero mean and unit variances, unless shifted."""
    from structid.engine.device import jnp  # in double precision from the first array on

    precision = jnp.asarray(np.linalg.inv(COVARIANCE))
    density = lambda theta: -0.5 * (theta - shift) @ precision @ (theta - shift)  # noqa: E731
    return si.LogDensity(density, NAMES, SPACE, backend="jax")


# Settings that decide the law, and the number of steps that makes its errors small.
SAMPLERS = {
    "AIES": (si.AIES, dict(walkers=20, ensembles=4, discard=0.2), 1500),
    "SMC": (si.SMC, dict(particles=200, ensembles=4, effective_share=0.5, correlation=0.5), 20),
    "NUTS": (si.NUTS, dict(warm_up=200), 600),
    "DelayedAcceptance": (si.DelayedAcceptance, dict(discard=0.5, tuning=10, most_sub_steps=16), 60),
}


def settings(name, steps):
    kind, fixed, _ = SAMPLERS[name]
    surrogate = dict(approximation=gaussian(0.3)) if kind is si.DelayedAcceptance else {}
    return kind(**fixed, **surrogate, steps=steps)


def test_no_sampler_is_forgotten():
    assert {kind for kind, *_ in SAMPLERS.values()} == concrete_subclasses(Sampler)


class Killed(Exception):
    pass


@pytest.fixture(scope="module")
def target():
    """One density for all, so that it is compiled once."""
    return gaussian()


@pytest.mark.parametrize("name", SAMPLERS)
class TestEverySampler:
    def test_moments_are_right_within_their_own_error(self, name, target):
        result = si.sample(target, settings(name, SAMPLERS[name][2]), seed=1)
        error = 1.0 / np.sqrt(result.summary().columns["ess_bulk"])
        assert error.max() < 0.1, "too few draws for the test to fail"
        assert (np.abs(result.mean) < 4.0 * error).all(), (result.mean, error)
        assert (np.abs(result.sd - 1.0) < 4.0 * error).all(), (result.sd, error)
        correlation = np.corrcoef(result.flat.T)[0, 1]
        assert abs(correlation - 0.8) < 4.0 * error.max()
        assert result.failed_simulations == 0 and not result.divergent
        if name in ("SMC", "NUTS"):  # walkers that know one another take more steps to say so
            assert result.verdict().converged, str(result.verdict())
        steps, ensembles, walkers, parameters = result.history.shape
        assert (steps, parameters) == (SAMPLERS[name][2], 3) and ensembles * walkers == len(result.draws)
        at_draws = target.log_density(result.history[-1].reshape(-1, 3))
        np.testing.assert_allclose(result.log_density[-1].ravel(), at_draws, rtol=1e-9, atol=1e-9)

    def test_one_seed_gives_one_chain_and_a_killed_one_goes_on_to_the_same_bits(self, name, target, tmp_path):
        sampler, path = settings(name, 60), tmp_path / "chains.h5"
        told = []
        whole = si.sample(target, sampler, seed=3, progress=lambda *done: told.append(done))
        assert told[-1][0] == told[-1][1] and [d for d, _ in told] == sorted(d for d, _ in told)
        assert len({total for _, total in told}) == 1 or type(sampler) is si.SMC  # whose stages are not known before
        assert not np.array_equal(si.sample(target, sampler, seed=4).history, whole.history)
        half = told[len(told) // 2]

        def stop(done, total):
            if (done, total) == half:
                raise Killed

        with pytest.raises(Killed):
            si.sample(target, sampler, seed=3, store=path, progress=stop)
        assert not path.exists() and list(tmp_path.iterdir())
        resumed = si.sample(target, sampler, seed=3, store=path)
        np.testing.assert_array_equal(resumed.history, whole.history)
        np.testing.assert_array_equal(resumed.log_density, whole.log_density)
        beside = ["chains.beside.h5"] if sampler.compared else []
        assert sorted(p.name for p in tmp_path.iterdir()) == [*beside, "chains.h5"]

    def test_a_store_is_read_lengthened_and_refused_to_others(self, name, target, tmp_path):
        path = tmp_path / "chains.h5"
        first = si.sample(target, settings(name, 60), seed=5, store=path)
        content = path.read_bytes()
        read = si.sample(target, settings(name, 60), seed=5, store=path, progress=lambda done, total: None)
        np.testing.assert_array_equal(read.history, first.history)
        for other, seed in ((target, 6), (gaussian(0.1), 5)):
            with pytest.raises(StoreMismatchError):
                si.sample(other, settings(name, 60), seed=seed, store=path)
        assert path.read_bytes() == content
        longer = si.sample(target, settings(name, 110), seed=5, store=path)
        assert len(longer.history) == 110
        np.testing.assert_array_equal(longer.history[:60], first.history)

    def test_it_says_what_it_is(self, name):
        sampler = settings(name, 60)
        described = sampler.describe()
        assert described == settings(name, 70).describe()  # more steps are the same chain
        assert described != SAMPLERS["AIES" if name != "AIES" else "SMC"][0]().describe()
        assert sampler.in_words and sampler.walkers >= 1 and sampler.ensembles >= 1
