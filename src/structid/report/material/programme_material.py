"""What a programme of hybrid tests leaves for its report."""

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
    """What was predicted of a test, and what then happened."""

    name: str  # Of the test
    time: Float[np.ndarray, " time"]  # Simulated time [s]
    drifts: Float[np.ndarray, "draw time"]  # Predicted displacements of the specimen's first channel [m]
    happened: Float[np.ndarray, " measured_time"]  # What they were [m]; shorter where the test ended before
    failed: int = 0  # Draws whose run failed; they are not in `drifts`
    reason: str = ""  # Why the first of them did

    @cached_property
    def peaks(self) -> np.ndarray:
        """Largest predicted displacements over the time that the test lasted, shape (draw,) [m]."""
        return np.asarray(np.abs(self.drifts[:, : len(self.happened)]).max(axis=1))

    @property
    def peak(self) -> float:
        """Largest displacement that happened [m]."""
        return float(np.abs(self.happened).max())

    @property
    def band(self) -> tuple[float, float]:
        """5 and 95 % of the largest displacement [m]."""
        low, high = np.quantile(self.peaks, BAND)
        return float(low), float(high)

    @property
    def covered(self) -> bool:
        """Whether the band of the largest displacement holds what happened."""
        low, high = self.band
        return low <= self.peak <= high

    @property
    def sentences(self) -> list[str]:
        """The band beside what happened, and how many draws are not in it."""
        said = []
        if len(self.drifts):
            low, high = (1e3 * edge for edge in self.band)
            said.append(
                f"For test {self.name} a largest displacement of {low:.4g} to {high:.4g} mm was predicted (5 to 95 %); it was "
                f"{1e3 * self.peak:.4g} mm. The band {'holds' if self.covered else 'does not hold'} it."
            )
        if self.failed:
            left = f"{self.failed} of {self.failed + len(self.drifts)} runs of the model failed for test {self.name}"
            said.append(f"{left}: {self.reason}. " + ("The band is without them." if said else "It is not predicted."))
        return said


@dataclass(frozen=True, eq=False)
class Learnt:
    """What a test has taught of the specimen."""

    from_test: str  # The last test that was looked at
    observation: Observation  # Forces against measured displacements of it and those before
    result: SamplingResult  # The posterior
    fitted: Float[np.ndarray, "time channel"] = field(repr=False)  # Forces at the most probable parameters [N]
    prediction: PredictedTest | None  # Of a later test
    calibration: CalibrationResult | None = None  # Certificate and rounds, where a surrogate was used

    @property
    def trusted(self) -> bool:
        """Whether its numbers may be believed: converged, and certified where a surrogate was used."""
        return self.result.verdict().converged if self.calibration is None else self.calibration.trusted


@dataclass(frozen=True, eq=False)
class ProgrammeMaterial:
    """What a programme leaves."""

    title: str  # Title, and the text of its file
    settings: str  # Title, and the text of its file
    programme: ProgrammeResult  # The tests
    learnt: Learnt | None = None  # What they have taught
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
        """Tests with a finished step."""
        return {name: test for name, test in self.programme.tests.items() if test.histories is not None}
