"""Fit of the best prediction to the measurement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.inference.likelihood.posterior import Posterior

UNEXPLAINED_LIMIT = 0.25
"""Fraction of the measurement's variance left unexplained above which a model is considered wrong."""


WRONG_BY = 8.0
"""Ratio of two peaks above which a unit is probably wrong; g in place of m/s² gives a ratio of 9.8."""


class BestPrediction(NamedTuple):
    """Fit of a prediction to the measurement."""

    # Unexplained fraction of the measurement's variance; the largest over measurements and channels
    unexplained: float
    peak: float  # predicted peak over measured peak, for the channel where they differ most

    @property
    def of_another_size(self) -> bool:
        """Whether predicted and measured peak differ so much that a unit is probably wrong; False for a good fit."""
        has_peak = bool(np.isfinite(self.peak))  # a failed run has no peak
        return has_peak and self.unexplained > UNEXPLAINED_LIMIT and not comparable(self.peak, 1.0)


UNMEASURED = BestPrediction(float("nan"), float("nan"))
"""Result without a measurement."""


def best_prediction(posterior: Posterior, theta: Float[np.ndarray, " parameter"]) -> BestPrediction:
    """Fraction of the measurements' variance left unexplained, Σ(y − M)² / Σ(y − ȳ)², and the ratio of peaks."""
    fractions, peaks = [], []
    for index, observation in enumerate(posterior.observations):
        measured, predicted = observation.values, posterior.predict(theta[None, :], index)[0]
        about_mean = np.nansum((measured - np.nanmean(measured, axis=0)) ** 2, axis=0)
        # A failed run must not look like a missing value.
        errors = np.where(observation.is_measured, measured - predicted, 0.0)
        fractions.append((errors**2).sum(axis=0) / about_mean)
        peaks.append(np.abs(np.where(observation.is_measured, predicted, 0.0)).max(axis=0) / observation.peaks)
    fraction, ratios = float(np.concatenate(fractions).max()), np.concatenate(peaks)
    with np.errstate(divide="ignore"):
        peak = float(ratios[np.argmax(np.abs(np.log(ratios)))])
    return BestPrediction(fraction if np.isfinite(fraction) else np.inf, peak)


def comparable(one: float, other: float) -> bool:
    """Whether two peaks are of similar size."""
    return bool(max(one, other) <= WRONG_BY * min(one, other))
