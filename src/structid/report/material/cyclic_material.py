"""Data for the report of a cyclic test."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from structid.core.errors import ConvergenceError
from structid.law_choice.choose_model import LawChoice
from structid.law_choice.cyclic_test import CyclicTest
from structid.law_choice.extrapolation import CyclicPrediction


@dataclass(frozen=True, eq=False)
class PredictedResponse:
    """Responses of the specimen under a mass to a record, one for each draw of the parameters."""

    time: Float[np.ndarray, " time"]  # [s]
    values: Float[np.ndarray, "draw time channel"]  # displacement [m], restoring force [N]
    failed: int = 0  # number of draws whose run failed

    def band(self, channel: int) -> tuple[np.ndarray, np.ndarray]:
        """5 and 95 % quantiles of a channel over the draws."""
        low, high = np.quantile(self.values[:, :, channel], [0.05, 0.95], axis=0)
        return low, high

    def peaks(self, channel: int) -> tuple[float, float, float]:
        """5, 50 and 95 % quantiles of the largest absolute value of a channel."""
        peaks = np.abs(self.values[:, :, channel]).max(axis=1)
        low, middle, high = np.quantile(peaks, [0.05, 0.5, 0.95])
        return float(low), float(middle), float(high)


@dataclass(frozen=True, eq=False)
class CyclicMaterial:
    """Data of a cyclic test and of the choice of its law."""

    title: str  # title
    settings: str  # text of the study file
    choice: LawChoice
    predictions: dict[str, CyclicPrediction] = field(default_factory=dict)  # forces along further paths
    responses: dict[str, PredictedResponse] = field(default_factory=dict)  # responses to records

    @property
    def test(self) -> CyclicTest:
        """The test."""
        return self.choice.cyclic_test

    @cached_property
    def force(self) -> Float[np.ndarray, " time"]:
        """Force of the chosen law at its least squares [N]."""
        return self.choice.least_squares_fit.fit.force(self.test)

    @cached_property
    def held_out(self) -> CyclicPrediction | None:
        """Prediction of the last half-cycles; None if no law could be fitted to parts of the test, or follow the rest."""
        if not self.choice.on_parts:
            return None
        try:
            return self.choice.held_out
        except ConvergenceError:
            return None
