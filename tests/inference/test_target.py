"""Bare log densities."""

import jax
import numpy as np

import structid as si
from structid.inference.target import LogDensity


def test_bare_log_densities_numpy_and_jax_agree():
    bounds = {"b": (0.0, np.inf), "c": (-1.0, 2.0)}
    start = si.ParameterSpace(a=si.Normal(0, 1), b=si.Gamma(mean=2, sd=1), c=si.Uniform(-1, 2))

    def density(theta, numpy=np):
        return -0.5 * theta[..., 0] ** 2 - theta[..., 1] + numpy.log(theta[..., 1]) - theta[..., 2]

    host = LogDensity(density, "abc", start, bounds)
    device = LogDensity(lambda t: density(t, jax.numpy), "abc", start, bounds, backend="jax")
    phi = host.initial(6, np.random.default_rng(0))
    np.testing.assert_allclose(host.evaluate(phi)[0], device.evaluate(phi)[0], rtol=1e-10)
    broken = LogDensity(lambda t: np.full(len(t), np.nan), "abc", start)
    assert broken.evaluate(phi)[1].all() and (broken.evaluate(phi)[0] == -np.inf).all()
