"""Data for the report of a programme of hybrid tests."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from structid.calibration.calibration_result import CalibrationResult
from structid.core.errors import InputError
from structid.hybrid.hybrid_result import HybridResult
from structid.hybrid.programme import ProgrammeResult
from structid.inference.sampling_result import SamplingResult
from structid.observation import Observation

BAND = (0.05, 0.95)
"""Quantiles at the bounds of a predicted band."""


@dataclass(frozen=True, eq=False)
class PredictedTest:
    """Prediction of a test, and the measured response in that test."""

    name: str  # name of the test
    time: Float[np.ndarray, " time"]  # simulated time [s]
    drifts: Float[np.ndarray, "draw time"]  # predicted displacements of the specimen's first channel [m]
    happened: Float[np.ndarray, " measured_time"]  # measured displacements [m]; shorter if the test ended early
    failed: int = 0  # number of draws with a failed run, which are not in `drifts`
    reason: str = ""  # reason of the first failure

    @cached_property
    def peaks(self) -> np.ndarray:
        """Largest predicted displacements during the test, shape (draw,) [m]."""
        return np.asarray(np.abs(self.drifts[:, : len(self.happened)]).max(axis=1))

    @property
    def peak(self) -> float:
        """Largest measured displacement [m]."""
        return float(np.abs(self.happened).max())

    @property
    def band(self) -> tuple[float, float]:
        """5 and 95 % quantiles of the largest displacement [m]."""
        low, high = np.quantile(self.peaks, BAND)
        return float(low), float(high)

    @property
    def covered(self) -> bool:
        """Whether the band of the largest displacement contains the measured value."""
        low, high = self.band
        return low <= self.peak <= high

    @property
    def sentences(self) -> list[str]:
        """Sentences on the band, the measured value, and the number of failed runs."""
        sentences = []
        if len(self.drifts):
            low, high = (1e3 * edge for edge in self.band)
            sentences.append(
                f"Predicted largest displacement in test {self.name}: {low:.4g} to {high:.4g} mm (5 to 95 %). Measured: "
                f"{1e3 * self.peak:.4g} mm, {'inside' if self.covered else 'outside'} the band."
            )
        if self.failed:
            failed = f"{self.failed} of {self.failed + len(self.drifts)} model runs failed for test {self.name}"
            sentences.append(
                f"{failed}: {self.reason}. " + ("The band excludes them." if sentences else "There is no prediction.")
            )
        return sentences


@dataclass(frozen=True, eq=False)
class Learnt:
    """Posterior of the specimen's parameters after a test."""

    from_test: str  # the last test used
    observation: Observation  # forces and measured displacements of this test and earlier tests
    result: SamplingResult  # the posterior
    fitted: Float[np.ndarray, "time channel"] = field(repr=False)  # forces at the most probable parameters [N]
    prediction: PredictedTest | None  # prediction of a later test
    calibration: CalibrationResult | None = None  # certificate and rounds, if a surrogate was used

    @property
    def trusted(self) -> bool:
        """Whether the posterior can be trusted: it has converged and, if a surrogate was used, is certified."""
        return self.result.verdict().converged if self.calibration is None else self.calibration.trusted


@dataclass(frozen=True, eq=False)
class ProgrammeMaterial:
    """Data of a programme."""

    title: str  # title
    settings: str  # text of the programme file
    programme: ProgrammeResult  # results of the tests
    learnt: Learnt | None = None  # posterior of the specimen's parameters
    # True parameters of a simulated specimen in SI, for parameters that the calibrated model also has
    true_values: dict[str, float] = field(default_factory=dict)

    @property
    def first(self) -> HybridResult:
        """The first test."""
        if not self.programme.tests:
            raise InputError("ProgrammeMaterial", "no test", "at least one started test")
        return next(iter(self.programme.tests.values()))

    @property
    def begun(self) -> dict[str, HybridResult]:
        """Tests with at least one completed step."""
        return {name: test for name, test in self.programme.tests.items() if test.histories is not None}
