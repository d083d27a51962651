"""Correlation functions of Kriging, ellipsoidal or separable, for NumPy arrays and inside JAX."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.array_module import namespace
from structid.engine.device import jnp

FAMILIES = ("exponential", "matern32", "matern52", "gaussian")
"""Names of the correlation functions."""


def correlation(
    family: str, separable: bool, a: Any, b: Any, log_lengths: Float[Array, " coordinate"]
) -> Float[Array, "n m"]:
    """Compute the correlations between two sets of points.

    Ellipsoidal: R(h) with h² = Σⱼ ((aⱼ − bⱼ)/ℓⱼ)²; separable: Πⱼ R(|aⱼ − bⱼ|/ℓⱼ). With the scaled distance h, R is exp(−h),
    (1 + √3 h) exp(−√3 h), (1 + √5 h + 5h²/3) exp(−√5 h) or exp(−h²/2) (Rasmussen & Williams 2006, section 4.2.1).
    """
    scaled = [
        (a[:, j, None] - b[None, :, j]) * jnp.exp(-log_lengths[j]) for j in range(a.shape[1])
    ]  # one coordinate at a time, so that XLA fuses them without an array of size (n, m, coordinate)
    return correlation_of(family, separable, scaled)


def correlation_of(family: str, separable: bool, scaled: Sequence[Any]) -> Any:
    """Compute correlations from scaled differences of points; see `correlation`."""
    if family == "gaussian" or not separable:
        return correlation_at(family, sum(s * s for s in scaled))
    # Polynomials are multiplied and exponents added, so one exponential suffices for all coordinates.
    xp = namespace(scaled[0])
    distance = [xp.abs(s) for s in scaled]
    product = 1.0
    for h in distance:
        product = product * _polynomial(family, h)
    return product * xp.exp(-_RATE[family] * sum(distance))


def correlation_at(family: str, square: Any) -> Any:
    """Compute ellipsoidal correlations from squared distances."""
    xp = namespace(square)
    if family == "gaussian":
        return xp.exp(-0.5 * square)
    # The derivative of the square root at 0 is infinite, but the derivative of the correlation is finite.
    h = np.sqrt(square) if xp is np else xp.where(square > 0, xp.sqrt(xp.where(square > 0, square, 1.0)), 0.0)
    return _polynomial(family, h) * xp.exp(-_RATE[family] * h)


def relative_slope(family: str, square: np.ndarray) -> Any:
    """Compute g = −R′(h)/(h R(h)), with which ∂R/∂log ℓⱼ = g(h) sⱼ² R for the scaled difference sⱼ = (aⱼ − bⱼ)/ℓⱼ.

    h is |sⱼ| if the correlation is separable, and else √Σ sⱼ². g is 1/h, 3/(1 + √3 h), 5/3 (1 + √5 h)/(1 + √5 h + 5h²/3), or 1.
    """
    if family == "gaussian":
        return 1.0
    h = np.sqrt(square)
    if family == "exponential":
        return np.divide(1.0, h, out=np.zeros_like(h), where=h > 0.0)
    rate = _RATE[family]
    return (
        rate**2 / (1.0 + rate * h)
        if family == "matern32"
        else rate**2 / 3.0 * (1.0 + rate * h) / _polynomial(family, h)
    )


_RATE = {"exponential": 1.0, "matern32": 3.0**0.5, "matern52": 5.0**0.5}


def _polynomial(family: str, h: Any) -> Any:
    """Return the polynomial factor of R before the exponential."""
    s = _RATE[family] * h
    return {"exponential": 1.0, "matern32": 1.0 + s, "matern52": 1.0 + s + s * s / 3.0}[family]
