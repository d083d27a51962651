"""Stage: the page of a study, its figures, and the netCDF file."""

from __future__ import annotations

from dataclasses import replace

from structid.inference.sampling_result import SamplingResult
from structid.report import section_list
from structid.report.drawing.drawn_sections import draw
from structid.report.material.material import PosteriorMaterial, RunsMaterial
from structid.report.page import write_posterior_report, write_runs_report
from structid.study.folder import FIGURES, POSTERIOR
from structid.study.stages.stage import Findings, StudyStage, Workplace


def _run(findings: Findings, workplace: Workplace) -> Findings:
    if findings.result is None:
        write_runs_page(findings, workplace)
        return findings
    material = posterior_material(findings, findings.result, workplace)
    _write_page(material, workplace)
    return replace(findings, material=material)


def write_runs_page(findings: Findings, workplace: Workplace) -> None:
    """Write the page of model runs and their surrogate."""
    file, study = findings.study.file, findings.parameter_study
    runs = study.runs if findings.runs is None and study is not None else findings.runs
    material = RunsMaterial(
        file.title or file.name, workplace.settings, runs, findings.surrogate, parameter_study=study
    )
    write_runs_report(material, workplace.folder, workplace.timings.seconds)


def _write_page(material: PosteriorMaterial, workplace: Workplace) -> None:
    with workplace.stage("predicting and drawing") as progress, workplace.timings.measured("predicting and drawing"):
        drawn = draw(section_list.OF_A_CALIBRATION, material, workplace.folder / FIGURES, progress)
        material.result.to_netcdf(workplace.folder / POSTERIOR)
    write_posterior_report(material, drawn, workplace.folder, workplace.timings.seconds)


def posterior_material(findings: Findings, result: SamplingResult, workplace: Workplace) -> PosteriorMaterial:
    """Collect the material for the page of a calibration."""
    study = findings.study
    assert findings.true_posterior is not None
    return PosteriorMaterial(
        title=study.file.title or study.file.name,
        settings=workplace.settings,
        runs=findings.runs,
        surrogate=findings.surrogate,
        result=result,
        true_posterior=findings.true_posterior,
        searches=findings.searches,
        raw_record=study.raw_record,
        record=study.record,
        truths=study.truths,
        true_values=study.true_values,
        other_records=study.other_records,
        prediction_draws=study.file.prediction.draws,
        predicted_channels=study.file.prediction.channels,
        calibration=findings.calibration,
        left_to_the_data=study.error_model_is_open,
        law_choice=findings.law_choice,
        parameter_study=findings.parameter_study,
        fragility=findings.fragility,
        loop=study.loop,
    )


def _has_something(findings: Findings) -> bool:
    return any(part is not None for part in (findings.result, findings.runs, findings.parameter_study))


STAGE = StudyStage(_has_something, _run)
