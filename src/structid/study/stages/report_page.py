"""Stage: write the page of a study, its figures, and the netCDF file of its draws."""

from __future__ import annotations

from structid.campaign.runs import Runs
from structid.inference.sampling_result import SamplingResult
from structid.reliability.parameter_study import ParameterStudy
from structid.report import section_list
from structid.report.drawing.drawn_sections import draw
from structid.report.material.material import PosteriorMaterial, RunsMaterial
from structid.report.page import write_posterior_report, write_runs_report
from structid.study.folder_layout import FIGURES, POSTERIOR
from structid.study.stages.stage import StudyStage, StudyState, Workplace


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    if SamplingResult not in state.results:
        write_runs_page(state, workplace)
        return state
    material = posterior_material(state, workplace)
    _write_page(material, workplace)
    return state.having(PosteriorMaterial, material)


def write_runs_page(state: StudyState, workplace: Workplace) -> None:
    """Write the page of model runs and their surrogate."""
    file, results = state.study.file, state.results
    material = RunsMaterial(file.title or file.name, workplace.settings, results)
    write_runs_report(material, workplace.folder, workplace.timings.seconds)


def _write_page(material: PosteriorMaterial, workplace: Workplace) -> None:
    with workplace.stage("predicting and drawing") as progress, workplace.timings.measured("predicting and drawing"):
        drawn = draw(section_list.OF_A_CALIBRATION, material, workplace.folder / FIGURES, progress)
        material.result.to_netcdf(workplace.folder / POSTERIOR)
    write_posterior_report(material, drawn, workplace.folder, workplace.timings.seconds)


def posterior_material(state: StudyState, workplace: Workplace) -> PosteriorMaterial:
    """Collect the data for the page of a calibration."""
    study = state.study
    assert state.true_posterior is not None
    return PosteriorMaterial(
        title=study.file.title or study.file.name,
        settings=workplace.settings,
        results=state.results,
        true_posterior=state.true_posterior,
        raw_record=study.raw_record,
        record=study.record,
        truths=study.truths,
        true_values=study.true_values,
        other_records=study.other_records,
        prediction_draws=study.file.prediction.draws,
        predicted_channels=study.file.prediction.channels,
        left_to_the_data=study.error_model_is_open,
        loop=study.loop,
    )


def _has_something(state: StudyState) -> bool:
    return any(kind in state.results for kind in (SamplingResult, Runs, ParameterStudy))


STAGE = StudyStage(PosteriorMaterial, _has_something, _run)
