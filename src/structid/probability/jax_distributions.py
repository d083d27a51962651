"""Log densities and cumulative distributions of the prior families inside JAX, before truncation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import scipy
from jax.scipy.special import betainc, gammainc, gammaln, ndtr

from structid.core.arrays import Array
from structid.engine.device import jnp

Parameters = Mapping[str, float]
Function = Callable[[Array, Parameters], Array]


class JaxDistribution(NamedTuple):
    """A family of distributions: log f(y) and F(y), given y and the family's native parameters."""

    log_density: Function
    cdf: Function


def _uniform_log_density(y: Array, p: Parameters) -> Array:
    return -jnp.broadcast_to(jnp.log(p["high"] - p["low"]), jnp.shape(y))


def _uniform_cdf(y: Array, p: Parameters) -> Array:
    return jnp.clip((y - p["low"]) / (p["high"] - p["low"]), 0.0, 1.0)


def _normal_log_density(y: Array, p: Parameters) -> Array:
    """Compute log f = −z²/2 − log(√(2π) σ), z = (y − μ)/σ."""
    z = (y - p["loc"]) / p["scale"]
    return -0.5 * z**2 - jnp.log(jnp.sqrt(2 * np.pi) * p["scale"])


def _normal_cdf(y: Array, p: Parameters) -> Array:
    return ndtr((y - p["loc"]) / p["scale"])


def _lognormal_log_density(y: Array, p: Parameters) -> Array:
    log_y = jnp.log(y)
    return 0.0 - log_y + _normal_log_density(log_y, p)


def _lognormal_cdf(y: Array, p: Parameters) -> Array:
    return _normal_cdf(jnp.log(y), p)


def _gamma_log_density(y: Array, p: Parameters) -> Array:
    """Compute log f = (α − 1) log y − λ y − log Γ(α) + α log λ."""
    shape, rate = p["concentration"], p["rate"]
    return (shape - 1) * jnp.log(y) - rate * y - (gammaln(shape) - shape * jnp.log(rate))


def _gamma_cdf(y: Array, p: Parameters) -> Array:
    return gammainc(p["concentration"], p["rate"] * y)


def _beta_log_density(y: Array, p: Parameters) -> Array:
    """Compute log f = (a − 1) log y + (b − 1) log(1 − y) − log B(a, b)."""
    powers = jnp.array([p["concentration1"], p["concentration0"]])
    log_beta = jnp.sum(gammaln(powers)) - gammaln(jnp.sum(powers))
    # At the ends of [0, 1] a safe value replaces y, since the derivative would be NaN.
    inside = (y > 0.0) & (y < 1.0)
    both = jnp.stack([jnp.where(inside, y, 0.5), jnp.where(inside, 1.0 - y, 0.5)], axis=-1)
    log_density = jnp.sum(jnp.log(both) * (powers - 1.0), axis=-1) - log_beta
    at_zero, at_one = scipy.stats.beta.logpdf((0.0, 1.0), p["concentration1"], p["concentration0"])
    return jnp.where(inside, log_density, jnp.where(y <= 0.0, at_zero, at_one))


def _beta_cdf(y: Array, p: Parameters) -> Array:
    return betainc(jnp.asarray(p["concentration1"]), jnp.asarray(p["concentration0"]), jnp.asarray(y))


def _weibull_log_density(y: Array, p: Parameters) -> Array:
    """Compute log f = −(y/λ)^k + log k + (k − 1) log y − k log λ."""
    shape, scale = p["concentration"], p["scale"]
    return -jnp.power(y / scale, shape) + jnp.log(shape) + (shape - 1.0) * jnp.log(y) - shape * jnp.log(scale)


def _weibull_cdf(y: Array, p: Parameters) -> Array:
    return 1 - jnp.exp(-((y / p["scale"]) ** p["concentration"]))


def _gumbel_log_density(y: Array, p: Parameters) -> Array:
    """Compute log f = −(z + e^(−z)) − log β, z = (y − μ)/β."""
    z = (y - p["loc"]) / p["scale"]
    return -(z + jnp.exp(-z)) - jnp.log(p["scale"])


def _gumbel_cdf(y: Array, p: Parameters) -> Array:
    return jnp.exp(-jnp.exp((p["loc"] - y) / p["scale"]))


JAX_DISTRIBUTIONS = {
    "Uniform": JaxDistribution(_uniform_log_density, _uniform_cdf),
    "Normal": JaxDistribution(_normal_log_density, _normal_cdf),
    "LogNormal": JaxDistribution(_lognormal_log_density, _lognormal_cdf),
    "Gamma": JaxDistribution(_gamma_log_density, _gamma_cdf),
    "Beta": JaxDistribution(_beta_log_density, _beta_cdf),
    "Weibull": JaxDistribution(_weibull_log_density, _weibull_cdf),
    "Gumbel": JaxDistribution(_gumbel_log_density, _gumbel_cdf),
}
"""JAX functions by family; any other distribution is evaluated on the host."""
