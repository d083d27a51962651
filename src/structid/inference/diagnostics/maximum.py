"""The maximum of a sampled density."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.inference.target import Target
from structid.optimize.pattern_search import pattern_search
from structid.probability.marginals import Uniform
from structid.probability.space import ParameterSpace


def maximum(
    target: Target, draws: Float[np.ndarray, "draw parameter"], log_density: Float[np.ndarray, " draw"]
) -> Float[np.ndarray, " parameter"]:
    """Search for the maximum of a density, starting from the draw with the highest density."""
    best = draws[int(np.argmax(log_density))]
    sd = np.maximum(draws.std(axis=0), 1e-12 * np.maximum(np.abs(draws.mean(axis=0)), 1e-300))
    bounds = target.bijection.bounds
    low = np.maximum(best - 5.0 * sd, bounds[:, 0])
    high = np.minimum(best + 5.0 * sd, bounds[:, 1])
    covariance = np.cov(draws.T).reshape(target.dimension, -1)
    objective = _NegativeLogDensity(target, low, high, covariance)
    best_point = pattern_search(objective, starts=best[None, :], tolerance=1e-5, iterations=400).best
    return best_point.theta if -best_point.value >= log_density.max() else best


class _NegativeLogDensity:
    """The objective −log π, with the inverse covariance of the draws as its curvature."""

    scale = 1.0
    differentiable = True

    def __init__(self, target: Target, low: np.ndarray, high: np.ndarray, covariance: np.ndarray) -> None:
        self.names, self._target = target.names, target
        box = {n: Uniform(a, b) for n, a, b in zip(target.names, low, high, strict=True)}
        self.space = ParameterSpace(box)
        # Inverted as a correlation matrix: in SI, variances of stiffnesses and of error variances differ by thirty decades.
        sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        correlation = covariance / np.outer(sd, sd)
        self._curvature = np.linalg.pinv(correlation, rcond=1e-12, hermitian=True) / np.outer(sd, sd)

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        return -self._target.log_density(theta)

    def linearised(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = len(theta)
        return np.zeros(count), np.zeros_like(theta), np.tile(self._curvature, (count, 1, 1))
