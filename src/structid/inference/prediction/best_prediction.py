"""How well the best prediction fits what was measured."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.inference.likelihood.posterior import Posterior

UNEXPLAINED_LIMIT = 0.25
"""A model is said to be wrong if its best prediction leaves this fraction of the measurement's variance unexplained."""


WRONG_BY = 8.0
"""Ratio of peaks beyond which a unit is likely to be wrong: g for m/s² is a factor of 9.8."""


class BestPrediction(NamedTuple):
    """How well a prediction fits what was measured."""

    # Fraction of the measurement's variance that it leaves unexplained; the largest over measurements and channels
    unexplained: float
    peak: float  # Its peak over the measured one, where both differ most

    @property
    def of_another_size(self) -> bool:
        """Whether it is so much smaller or larger than the measurement that a unit is probably wrong; never where it fits."""
        known = bool(np.isfinite(self.peak))  # there is none where the run failed
        return known and self.unexplained > UNEXPLAINED_LIMIT and not comparable(self.peak, 1.0)


UNMEASURED = BestPrediction(float("nan"), float("nan"))
"""Where there is nothing to compare with."""


def best_prediction(posterior: Posterior, theta: Float[np.ndarray, " parameter"]) -> BestPrediction:
    """Fraction of the measurements' variance that a prediction leaves unexplained, Σ(y − M)² / Σ(y − ȳ)², and how large it is."""
    fractions, peaks = [], []
    for index, observation in enumerate(posterior.observations):
        measured, predicted = observation.values, posterior.predict(theta[None, :], index)[0]
        about_mean = ((measured - measured.mean(axis=0)) ** 2).sum(axis=0)
        fractions.append(((measured - predicted) ** 2).sum(axis=0) / about_mean)
        peaks.append(np.abs(predicted).max(axis=0) / np.abs(measured).max(axis=0))
    fraction, ratios = float(np.concatenate(fractions).max()), np.concatenate(peaks)
    with np.errstate(divide="ignore"):
        peak = float(ratios[np.argmax(np.abs(np.log(ratios)))])
    return BestPrediction(fraction if np.isfinite(fraction) else np.inf, peak)


def comparable(one: float, other: float) -> bool:
    """Say whether two peaks are of similar size."""
    return bool(max(one, other) <= WRONG_BY * min(one, other))
