"""Run a study, from the study file to the report. Finished work is on disk, and an interrupted run can continue."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from structid.calibration.calibration_result import CalibrationResult
from structid.campaign.executors import kept_open, run_map
from structid.campaign.runs import Runs
from structid.campaign.store import CAMPAIGN_RUNS, open_runs
from structid.core.by_type import ByType
from structid.core.errors import InputError, StructidWarning
from structid.inference.sampling_result import SamplingResult
from structid.report.material.material import PosteriorMaterial, RunsMaterial
from structid.report.page import PAGE, write_runs_report
from structid.study.build_study import build
from structid.study.building.built_study import BuiltStudy
from structid.study.folder import claim, left_as_it_was, rebuilt, stored_study
from structid.study.folder_layout import SCRATCH, SURROGATE
from structid.study.schema.study_file import StudyFile
from structid.study.stages import stage_list
from structid.study.stages.report_page import posterior_material
from structid.study.stages.stage import StudyState, Workplace
from structid.study.study_reader import read_study, stands_alone
from structid.study.timings import Stage, silent
from structid.surrogates.base import Surrogate
from structid.surrogates.surrogate_list import load_surrogate


@dataclass(frozen=True, eq=False)
class StudyOutcome:
    """Outcome of a study."""

    results: ByType  # results of its stages, by type
    report: Path  # path of the page
    material: PosteriorMaterial | None = None  # data of the page; None for a study without an observation

    @property
    def result(self) -> SamplingResult | None:
        """Posterior draws and their verdict; None for a study without an observation."""
        return self.results.get(SamplingResult)

    @property
    def trusted(self) -> bool:
        """Whether the results can be trusted: the sampling has converged and, if requested, the surrogate is certified."""
        if (calibration := self.results.get(CalibrationResult)) is not None:
            return calibration.trusted
        return self.result is None or self.result.verdict().converged


def load(path: str | Path) -> BuiltStudy:
    """Read a study file and build the study."""
    return build(read_study(path), Path(path).resolve().parent)


def load_of_one_law(path: str | Path) -> BuiltStudy:
    """Read a study file and build the study; refuse a study whose hysteretic law is left to the data."""
    study = load(path)
    if study.motion_test is None:
        return study
    raise InputError(
        f"{path}, key 'model.law'",
        "a choice among laws",
        "the name of a law",
        "Run the study first; its report names the law.",
    )


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
    ):  # a missing executor is reported before the folder is reserved
        claim(folder, study, Path(path), resume or retry or adopt, adopt)
        workplace = Workplace(folder, stage, workers, retry, adopt)
        return _work(study, workplace)


def report_again(folder: str | Path, stage: Stage = silent) -> StudyOutcome:
    """Rewrite the report from stored results."""
    folder = Path(folder)
    file, identity = stored_study(folder)
    workplace = Workplace(folder, stage)
    if not (file.observation or stands_alone(file)):
        # A study with runs only does not need its solver, which may have changed or be missing.
        return _runs_again(file, workplace)
    return _work(rebuilt(folder, file, identity), workplace)


def _runs_again(file: StudyFile, workplace: Workplace) -> StudyOutcome:
    """Write the page of stored runs and their surrogate; the model is not needed."""
    runs, fitted = open_runs(workplace.folder / CAMPAIGN_RUNS), workplace.folder / SURROGATE
    surrogate = load_surrogate(fitted) if fitted.is_file() else None
    results = ByType({Runs: runs, Surrogate: surrogate})
    material = RunsMaterial(file.title or file.name, workplace.settings, results)
    return StudyOutcome(results, write_runs_report(material, workplace.folder, workplace.timings.seconds))


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
            warnings.simplefilter("ignore", StructidWarning)  # the verdict contains the warnings of a surrogate
        state = StudyState(study, true_posterior=study.posterior)
        for stage in (*stage_list.STAGES, *([stage_list.PAGE_STAGE] if workplace.page else [])):
            if stage.wanted(state):
                state = stage.run(state, workplace)
    material = state.results.get(PosteriorMaterial)
    if material is None and SamplingResult in state.results:  # no page was requested
        material = posterior_material(state, workplace)
    return StudyOutcome(state.results, workplace.folder / PAGE, material)
