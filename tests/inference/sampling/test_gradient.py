"""NUTS: closed-form moments, agreement with SMC on an oscillator, exact gradients, the same after a kill."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from structid.errors import InputError
from structid.inference.sampling.gradient import _Kernels

SMALL = si.NUTS(steps=200, warm_up=200)
NAMES = ("a", "b", "c")
COVARIANCE = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.3], [0.0, 0.3, 1.0]])


def gaussian():
    from structid.device import jnp  # in double precision from the first array on

    precision = jnp.asarray(np.linalg.inv(COVARIANCE))
    space = si.ParameterSpace(**{n: si.Normal(0.0, 5.0) for n in NAMES})
    return si.LogDensity(lambda theta: -0.5 * theta @ precision @ theta, NAMES, space, backend="jax")


def test_moments_of_a_gaussian():
    result = si.sample(gaussian(), replace(SMALL, steps=600), seed=1)
    assert result.verdict().converged, str(result.verdict())
    error = 1.0 / np.sqrt(result.summary().columns["ess_bulk"])
    assert (np.abs(result.mean) < 4.0 * error).all()
    assert (np.abs(result.sd - 1.0) < 4.0 * error).all()
    assert result.history.shape == (600, 4, 1, 3) and result.divergent == 0


def test_a_killed_one_goes_on_to_the_same_bits(tmp_path):
    whole = si.sample(gaussian(), SMALL, seed=3)

    def stop(done, total):
        if done >= 300:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        si.sample(gaussian(), SMALL, seed=3, store=tmp_path / "chains.h5", progress=stop)
    resumed = si.sample(gaussian(), SMALL, seed=3, store=tmp_path / "chains.h5")
    np.testing.assert_array_equal(resumed.history, whole.history)
    longer = si.sample(gaussian(), replace(SMALL, steps=230), seed=3, store=tmp_path / "chains.h5")
    np.testing.assert_array_equal(longer.history[:200], whole.history)
    assert len(longer.history) == 230


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
