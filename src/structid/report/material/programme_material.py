"""Data of a programme of hybrid tests for its report."""

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
"""Quantiles of a predicted band."""


@dataclass(frozen=True, eq=False)
class PredictedTest:
    """Prediction of a test, and its actual course."""

    name: str  # name of the test
    time: Float[np.ndarray, " time"]  # simulated time [s]
    drifts: Float[np.ndarray, "draw time"]  # predicted displacements of the specimen's first channel [m]
    happened: Float[np.ndarray, " measured_time"]  # actual ones [m]; shorter where the test ended early
    failed: int = 0  # number of draws with a failed run, which are not in `drifts`
    reason: str = ""  # reason of the first of them

    @cached_property
    def peaks(self) -> np.ndarray:
        """Largest predicted displacements during the test, shape (draw,) [m]."""
        return np.asarray(np.abs(self.drifts[:, : len(self.happened)]).max(axis=1))

    @property
    def peak(self) -> float:
        """Largest actual displacement [m]."""
        return float(np.abs(self.happened).max())

    @property
    def band(self) -> tuple[float, float]:
        """5 and 95 % of the largest displacement [m]."""
        low, high = np.quantile(self.peaks, BAND)
        return float(low), float(high)

    @property
    def covered(self) -> bool:
        """Whether the band of the largest displacement contains the actual one."""
        low, high = self.band
        return low <= self.peak <= high

    @property
    def sentences(self) -> list[str]:
        """The band and the actual value, and the number of missing draws."""
        sentences = []
        if len(self.drifts):
            low, high = (1e3 * edge for edge in self.band)
            sentences.append(
                f"For test {self.name} a largest displacement of {low:.4g} to {high:.4g} mm was predicted (5 to 95 %); it was "
                f"{1e3 * self.peak:.4g} mm. The band {'holds' if self.covered else 'does not hold'} it."
            )
        if self.failed:
            left = f"{self.failed} of {self.failed + len(self.drifts)} runs of the model failed for test {self.name}"
            sentences.append(
                f"{left}: {self.reason}. " + ("The band is without them." if sentences else "It is not predicted.")
            )
        return sentences


@dataclass(frozen=True, eq=False)
class Learnt:
    """What was learnt of the specimen from a test."""

    from_test: str  # the last test used
    observation: Observation  # forces against measured displacements of it and earlier tests
    result: SamplingResult  # the posterior
    fitted: Float[np.ndarray, "time channel"] = field(repr=False)  # forces at the most probable parameters [N]
    prediction: PredictedTest | None  # prediction of a later test
    calibration: CalibrationResult | None = None  # certificate and rounds, if a surrogate was used

    @property
    def trusted(self) -> bool:
        """Whether its numbers may be believed: converged, and certified where a surrogate was used."""
        return self.result.verdict().converged if self.calibration is None else self.calibration.trusted


@dataclass(frozen=True, eq=False)
class ProgrammeMaterial:
    """Data of a programme."""

    title: str  # title
    settings: str  # text of its file
    programme: ProgrammeResult  # the tests
    learnt: Learnt | None = None  # what was learnt
    # Parameters of a simulated specimen in SI, where the model that is learnt has them
    true_values: dict[str, float] = field(default_factory=dict)

    @property
    def first(self) -> HybridResult:
        """The first test."""
        if not self.programme.tests:
            raise InputError("ProgrammeMaterial", "no test", "one that was begun")
        return next(iter(self.programme.tests.values()))

    @property
    def begun(self) -> dict[str, HybridResult]:
        """Tests with a completed step."""
        return {name: test for name, test in self.programme.tests.items() if test.histories is not None}
