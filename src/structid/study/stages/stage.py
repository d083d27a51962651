"""A stage of a study: it takes the findings of earlier stages and adds its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from structid.calibration.calibration_result import CalibrationResult
from structid.campaign.runs import Runs
from structid.inference.error_model_choice import ErrorModelChoice
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
    """Where and how a study runs."""

    folder: Path  # output folder
    stage: Stage  # opens a progress bar for a named stage
    executor: Any = None  # executor of an external model's runs
    retry: bool = False  # repeat failed runs of the campaign
    adopt: bool = False  # keep the model runs of another version of the model
    page: bool = True  # whether to write the page

    @cached_property
    def timings(self) -> Timings:
        """Duration of every stage."""
        return Timings(self.folder / TIMINGS)

    @property
    def settings(self) -> str:
        """Text of the study file."""
        return (self.folder / STUDY).read_text(encoding="utf-8")


@dataclass(frozen=True, eq=False)
class Findings:
    """Findings of a study's stages so far."""

    study: BuiltStudy  # the study, with the posterior and the sampler in use
    true_posterior: Posterior | None = None  # the posterior under the model itself
    runs: Runs | None = None  # model runs
    surrogate: Surrogate | None = None  # the validated or certified surrogate
    calibration: CalibrationResult | None = None  # certificate and rounds
    searches: dict[str, OptimizeResult] = field(default_factory=dict)  # deterministic calibrations by method
    law_choice: ErrorModelChoice | None = None  # error model chosen by the data
    result: SamplingResult | None = None  # draws and verdict
    parameter_study: ParameterStudy | None = None  # results of runs over the priors
    fragility: Fragility | None = None  # probability of a passage, given the data
    material: PosteriorMaterial | None = None  # everything for the page, with its simulations


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
