"""What a stage of a study is: it takes what stages before it have found, and adds its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from structid.calibration.calibration_result import CalibrationResult
from structid.campaign.runs import Runs
from structid.inference.error_model_choice import LawChoice
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult
from structid.optimize.minima import OptimizeResult
from structid.reliability.fragility import Fragility
from structid.reliability.parameter_study import ParameterStudy
from structid.report.material.material import PosteriorMaterial
from structid.study.building.built_study import BuiltStudy
from structid.study.folder import STUDY, TIMINGS
from structid.study.timings import Stage, Timings
from structid.surrogates.base import Surrogate


@dataclass(frozen=True, eq=False)
class Workplace:
    """Where and how a study is run."""

    folder: Path  # For everything that it makes
    stage: Stage  # Opens a progress bar for a named stage
    executor: Any = None  # Where an external model's runs are done
    retry: bool = False  # Repeat runs of the campaign that failed before
    adopt: bool = False  # Keep the true runs of another version of the model
    page: bool = True  # Write the page

    @cached_property
    def timings(self) -> Timings:
        """Seconds of every stage."""
        return Timings(self.folder / TIMINGS)

    @property
    def settings(self) -> str:
        """Text of the study file."""
        return (self.folder / STUDY).read_text(encoding="utf-8")


@dataclass(frozen=True, eq=False)
class Findings:
    """What the stages of a study have found so far."""

    study: BuiltStudy  # The study, with the posterior and the sampler to be used
    true_posterior: Posterior | None = None  # The posterior under the model itself
    runs: Runs | None = None  # The true runs
    surrogate: Surrogate | None = None  # What stands in for the model, validated or certified
    calibration: CalibrationResult | None = None  # Certificate and rounds
    searches: dict[str, OptimizeResult] = field(default_factory=dict)  # Deterministic calibrations by method
    law_choice: LawChoice | None = None  # Which law of the errors the data have chosen, where it was left to them
    result: SamplingResult | None = None  # Draws and verdict
    parameter_study: ParameterStudy | None = None  # What runs over the priors tell
    fragility: Fragility | None = None  # The probability of a passage, given the data
    material: PosteriorMaterial | None = None  # All of it as a page takes it, with what the page has simulated


@dataclass(frozen=True)
class StudyStage:
    """One stage.

    Parameters
    ----------
    wanted : callable
        Whether the study asks for it, by what has been found.
    run : callable
        Does it, or reads back what was done, and returns the findings with its own added.
    """

    wanted: Callable[[Findings], bool]
    run: Callable[[Findings, Workplace], Findings]
