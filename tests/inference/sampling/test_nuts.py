"""NUTS beyond what every sampler keeps (`tests/seams`): exact gradients, what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.inference.sampling.nuts import _Kernels

SMALL = si.NUTS(steps=200, warm_up=200)


def test_the_gradient_of_a_posterior_is_exact(short_posterior):
    import jax

    phi = short_posterior.initial(1, np.random.default_rng(1))[0]
    density = _Kernels(short_posterior, SMALL)._density(short_posterior.data)
    gradient = np.asarray(jax.jit(jax.grad(density))(phi))
    for i, direction in enumerate(np.eye(len(phi))):
        step = 1e-5 * direction
        ends = short_posterior.evaluate(np.stack([phi + step, phi - step]))[0]
        assert gradient[i] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4, abs=1e-4 * np.abs(gradient).max())


def test_nothing_without_derivatives():
    plain = si.LogDensity(lambda t: -(t[:, 0] ** 2), ("x",), np.zeros((9, 1)))
    with pytest.raises(InputError, match=r"NUTS.*without derivatives.*SMC or AIES"):
        si.sample(plain, SMALL, seed=1)


@pytest.mark.parametrize(
    ("change", "words"),
    [(dict(steps=1), "steps.*2 or more"), (dict(warm_up=10), "warm_up.*50"), (dict(target_acceptance=1.5), "fraction")],
)
def test_settings_that_make_no_sense(change, words):
    with pytest.raises(InputError, match=words):
        replace(SMALL, **change)


def test_an_unconverged_run_blames_the_sampler_and_nothing_else(short_posterior):
    """Priors and model are not judged by draws that are not the posterior's."""
    result = si.sample(short_posterior, si.AIES(walkers=16, steps=40, ensembles=2), seed=1)
    verdict = result.verdict()
    assert not verdict.converged and verdict.failures and not verdict.wrong_model and not verdict.wrong_error_model
    assert not [w for w in verdict.warnings if "prior" in w or "surrogate" in w]
    assert "assessed once the run has converged" in str(verdict)
    assert result.robust is None and result.drift is None
