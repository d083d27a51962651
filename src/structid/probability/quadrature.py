"""Quadrature nodes for integrals over a quantile function."""

from __future__ import annotations

import functools

import numpy as np
import scipy


@functools.cache
def probability_nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities p and weights w with ∫₀¹ f(p) dp = Σ w f(p), dense in both tails, where quantile functions are steep.

    Gauss-Legendre rule in φ, with p = sin²(φ).
    """
    nodes, weights = scipy.special.roots_legendre(count)
    angle = 0.25 * np.pi * (nodes + 1.0)
    result = np.sin(angle) ** 2, 0.25 * np.pi * weights * np.sin(2.0 * angle)
    for array in result:
        array.flags.writeable = False
    return result
