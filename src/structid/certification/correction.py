"""Correction of the drawn density q by a density q′ that lies between q and the true posterior π.

The differences between the moments of q and q′ need no model run, since both densities are functions. Model runs bound the
differences between q′ and π, which are small if q′ is good. The sum of both then bounds the errors of q more sharply than the
weights π/q: the weights bound a possible error, while the correction measures the actual error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from structid.certification.limits import Limits

ERRORS = 3.0
"""Number of Monte Carlo standard errors added to the shift of a mean."""


@dataclass(frozen=True, eq=False)
class Correction:
    """Difference of q′ from q."""

    distance: float  # total variation, ½ ∫|q′ − q|: no probability of an event differs by more
    mean: Float[np.ndarray, " parameter"]  # mean of q′ minus mean of q, in standard deviations of q
    mean_error: Float[np.ndarray, " parameter"]  # Monte Carlo error of `mean`
    sd: Float[np.ndarray, " parameter"]  # ratio of the standard deviations of q′ and q
    correlation: Float[np.ndarray, "parameter parameter"]  # difference of the correlations of q′ and q

    @classmethod
    def between(
        cls,
        theta: Float[np.ndarray, "point parameter"],
        of_law: Float[np.ndarray, " point"],
        of_learnt: Float[np.ndarray, " point"],
    ) -> Correction:
        """Compare two densities at points at which both are known."""
        old, new = of_law / of_law.sum(), of_learnt / of_learnt.sum()
        middle = old @ theta
        sd = np.sqrt(old @ (theta - middle) ** 2)
        standard = (theta - middle) / np.where(sd > 0.0, sd, 1.0)
        mean = new @ standard
        # Error of the difference of two self-normalised estimates at the same points, over an estimated standard deviation.
        scale = 0.5 * mean * (standard**2 - 1.0)
        contributions = new[:, None] * (standard - mean) - old[:, None] * (standard + scale)
        return cls(
            0.5 * float(np.abs(new - old).sum()),
            np.asarray(mean),
            np.sqrt(np.sum(contributions**2, axis=0)),
            np.sqrt(new @ (standard - mean) ** 2),
            _correlations(standard, new) - _correlations(standard, old),
        )

    def beyond(self, limits: Limits) -> bool:
        """Whether the difference of q from q′ alone exceeds the limits."""
        return bool(
            np.abs(self.mean).max() > limits.mean
            or np.abs(self.sd - 1.0).max() > limits.sd
            or np.abs(self.correlation).max() > limits.correlation
        )

    def said_of(self, index: int, name: str) -> str:
        """Describe the error of a mean."""
        return f"the mean of {name} is shifted by {self.mean[index]:+.2f} ± {self.mean_error[index]:.2f} standard deviations"

    def mean_bound(self, bound: Float[np.ndarray, " parameter"]) -> Float[np.ndarray, " parameter"]:
        """Bound on the error of the means of q."""
        return np.asarray(np.abs(self.mean) + ERRORS * self.mean_error + bound * self.sd)

    def sd_bound(self, bound: Float[np.ndarray, " parameter"]) -> Float[np.ndarray, " parameter"]:
        """Bound on the relative error of the standard deviations of q."""
        return np.asarray((1.0 + np.abs(self.sd - 1.0)) * (1.0 + bound) - 1.0)

    def correlation_bound(
        self, bound: Float[np.ndarray, "parameter parameter"]
    ) -> Float[np.ndarray, "parameter parameter"]:
        """Bound on the error of the correlations of q."""
        return np.asarray(np.abs(self.correlation) + bound)


def _correlations(theta: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Correlations of weighted points; 0 for a parameter without spread."""
    away = theta - weights @ theta
    covariance = (weights[:, None] * away).T @ away
    sd = np.sqrt(np.diag(covariance))
    scale = np.where(sd > 0.0, sd, 1.0)
    return np.asarray(covariance / np.outer(scale, scale))
