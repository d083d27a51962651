"""Run a study from its file to its report. Completed work is on disk, and an interrupted run continues."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from structid.calibration.calibration_result import CalibrationResult
from structid.campaign.executors import kept_open, run_map
from structid.campaign.runs import Runs
from structid.campaign.store import CAMPAIGN_RUNS, open_runs
from structid.core.errors import StructidWarning
from structid.inference.error_model_choice import ErrorModelChoice
from structid.inference.sampling_result import SamplingResult
from structid.optimize.minima import OptimizeResult
from structid.reliability.fragility import Fragility
from structid.reliability.parameter_study import ParameterStudy
from structid.report.material.material import PosteriorMaterial, RunsMaterial
from structid.report.page import PAGE, write_runs_report
from structid.study.building.built_study import BuiltStudy
from structid.study.building.study import build
from structid.study.folder import SCRATCH, SURROGATE, claim, left_as_it_was, rebuilt, stored_study
from structid.study.schema.study_file import StudyFile, read_study
from structid.study.stages import stage_list
from structid.study.stages.report_page import posterior_material
from structid.study.stages.stage import Findings, Workplace
from structid.study.timings import Stage, silent
from structid.surrogates.base import Surrogate
from structid.surrogates.surrogate_list import load_surrogate


@dataclass(frozen=True, eq=False)
class StudyOutcome:
    """Outcome of a study."""

    result: SamplingResult | None  # Draws and verdict; None for a study without an observation
    searches: dict[str, OptimizeResult]  # deterministic calibrations by method
    report: Path  # the page
    runs: Runs | None = None  # runs of the campaign
    surrogate: Surrogate | None = None  # the validated surrogate
    calibration: CalibrationResult | None = None  # certificate and rounds
    law_choice: ErrorModelChoice | None = None  # error model chosen by the data
    parameter_study: ParameterStudy | None = None  # results of runs over the priors
    # The probability of a passage or of a failure for records of rising strength, where the study asks for it
    fragility: Fragility | None = None
    material: PosteriorMaterial | None = None  # everything for the page; None for a study without an observation

    @property
    def trusted(self) -> bool:
        """Whether its numbers may be believed: converged, and certified where requested."""
        if self.calibration is not None:
            return self.calibration.trusted
        return self.result is None or self.result.verdict().converged


def load(path: str | Path) -> BuiltStudy:
    """Read and build a study file."""
    return build(read_study(path), Path(path).resolve().parent)


def run_study(
    path: str | Path,
    out: str | Path,
    resume: bool = False,
    stage: Stage = silent,
    executor: Any = None,
    retry: bool = False,
    adopt: bool = False,
    built: BuiltStudy | None = None,
) -> StudyOutcome:
    """Run a study."""
    study = load(path) if built is None else built
    folder = Path(out)
    with (
        left_as_it_was(folder),
        kept_open(study.model, executor) as workers,
    ):  # a missing executor is reported before a folder is taken
        claim(folder, study, Path(path), resume or retry or adopt, adopt)
        workplace = Workplace(folder, stage, workers, retry, adopt)
        return _work(study, workplace)


def report_again(folder: str | Path, stage: Stage = silent) -> StudyOutcome:
    """Write the report again from what is stored."""
    folder = Path(folder)
    file, identity = stored_study(folder)
    workplace = Workplace(folder, stage)
    if not (file.observation or file.parameter_study):
        # Runs alone: the solver is not needed, and may have changed or gone.
        return _runs_again(file, workplace)
    return _work(rebuilt(folder, file, identity), workplace)


def _runs_again(file: StudyFile, workplace: Workplace) -> StudyOutcome:
    """Show stored runs and their surrogate without the model."""
    runs, fitted = open_runs(workplace.folder / CAMPAIGN_RUNS), workplace.folder / SURROGATE
    surrogate = load_surrogate(fitted) if fitted.is_file() else None
    material = RunsMaterial(file.title or file.name, workplace.settings, runs, surrogate)
    page = write_runs_report(material, workplace.folder, workplace.timings.seconds)
    return StudyOutcome(None, {}, page, runs, surrogate)


def stored_outcome(folder: str | Path, stage: Stage = silent) -> StudyOutcome:
    """Read the stored outcome of a study without writing anything."""
    folder = Path(folder)
    workplace = Workplace(folder, stage, page=False)
    return _work(rebuilt(folder, *stored_study(folder)), workplace)


def _work(study: BuiltStudy, workplace: Workplace) -> StudyOutcome:
    """Run the stages of the study."""
    study = study.working_in(workplace.folder.resolve() / SCRATCH)
    with run_map(study.model, workplace.executor) as map_of_runs, warnings.catch_warnings():
        if study.posterior is not None:
            study = replace(study, posterior=study.posterior.mapped_by(map_of_runs))
            warnings.simplefilter("ignore", StructidWarning)  # what a surrogate warns of is in the verdict
        findings = Findings(study, true_posterior=study.posterior)
        for stage in (*stage_list.STAGES, *([stage_list.PAGE_STAGE] if workplace.page else [])):
            if stage.wanted(findings):
                findings = stage.run(findings, workplace)
    material = findings.material
    if material is None and findings.result is not None:  # no page was asked for
        material = posterior_material(findings, findings.result, workplace)
    return StudyOutcome(
        findings.result,
        findings.searches,
        workplace.folder / PAGE,
        findings.runs,
        findings.surrogate,
        findings.calibration,
        findings.law_choice,
        findings.parameter_study,
        findings.fragility,
        material,
    )
