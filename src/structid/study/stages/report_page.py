"""The page of a study, its figures, and the netCDF file."""

from __future__ import annotations

from dataclasses import replace

from structid.inference.sampling_result import SamplingResult
from structid.report import section_list
from structid.report.drawing.drawn_sections import draw
from structid.report.material.material import PosteriorMaterial, RunsMaterial
from structid.report.page import write_posterior_report, write_runs_report
from structid.study.folder import FIGURES, POSTERIOR
from structid.study.stages.stage import Findings, StudyStage, Workplace


def _run(found: Findings, place: Workplace) -> Findings:
    if found.result is None:
        write_runs_page(found, place)
        return found
    material = posterior_material(found, found.result, place)
    _write_page(material, place)
    return replace(found, material=material)


def write_runs_page(found: Findings, place: Workplace) -> None:
    """Write the page of true runs, and of what was fitted to them."""
    file, study = found.study.file, found.parameter_study
    runs = study.runs if found.runs is None and study is not None else found.runs
    material = RunsMaterial(file.title or file.name, place.settings, runs, found.surrogate, parameter_study=study)
    write_runs_report(material, place.folder, place.timings.seconds)


def _write_page(material: PosteriorMaterial, place: Workplace) -> None:
    with place.stage("predicting and drawing") as progress, place.timings.measured("predicting and drawing"):
        drawn = draw(section_list.OF_A_CALIBRATION, material, place.folder / FIGURES, progress)
        material.result.to_netcdf(place.folder / POSTERIOR)
    write_posterior_report(material, drawn, place.folder, place.timings.seconds)


def posterior_material(found: Findings, result: SamplingResult, place: Workplace) -> PosteriorMaterial:
    """Put together what a calibration leaves for its page."""
    study = found.study
    assert found.true_posterior is not None
    return PosteriorMaterial(
        title=study.file.title or study.file.name,
        settings=place.settings,
        runs=found.runs,
        surrogate=found.surrogate,
        result=result,
        true_posterior=found.true_posterior,
        searches=found.searches,
        raw_record=study.raw_record,
        record=study.record,
        truths=study.truths,
        true_values=study.true_values,
        other_records=study.other_records,
        prediction_draws=study.file.prediction.draws,
        predicted_channels=study.file.prediction.channels,
        calibration=found.calibration,
        left_to_the_data=study.law_is_open,
        law_choice=found.law_choice,
        parameter_study=found.parameter_study,
        fragility=found.fragility,
        loop=study.loop,
    )


def _has_something(found: Findings) -> bool:
    return any(part is not None for part in (found.result, found.runs, found.parameter_study))


STAGE = StudyStage(_has_something, _run)
