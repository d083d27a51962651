"""Run the study of a cyclic test, from its file to the report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.law_choice.choose_model import LawChoice, choose_model
from structid.models.finer_steps import simulate_in_steps_it_needs
from structid.report.material.cyclic_material import CyclicMaterial, PredictedResponse
from structid.report.page import write_cyclic_report
from structid.study.cyclic_tests.cyclic_test_file import parse_cyclic_test
from structid.study.cyclic_tests.planned_cyclic_test import PlannedCyclicTest, load_cyclic_test, planned_cyclic_test
from structid.study.folder_layout import INPUTS, POSTERIOR, STUDY, TIMINGS
from structid.study.kept_inputs import claim_for_text, kept_content
from structid.study.schema.study_file import study_text
from structid.study.timings import Stage, Timings, silent


@dataclass(frozen=True, eq=False)
class CyclicOutcome:
    """Outcome of the study of a cyclic test."""

    choice: LawChoice
    report: Path  # path of the page
    material: CyclicMaterial  # data of the page

    @property
    def trusted(self) -> bool:
        """Whether the draws of the chosen law have converged."""
        return self.choice.result.verdict().converged


def run_cyclic_test(path: str | Path, out: str | Path, resume: bool = False, stage: Stage = silent) -> CyclicOutcome:
    """Run the study of a cyclic test."""
    planned, folder = load_cyclic_test(path), Path(out)
    claim_for_text(folder, Path(path), resume, "study")
    return _work(planned, folder, stage)


def cyclic_report_again(folder: str | Path, stage: Stage = silent) -> CyclicOutcome:
    """Rewrite the report from stored fits and draws."""
    folder = Path(folder)
    return _work(
        planned_cyclic_test(parse_cyclic_test(kept_content(folder), str(folder / STUDY)), folder / INPUTS),
        folder,
        stage,
    )


def _work(planned: PlannedCyclicTest, folder: Path, stage: Stage) -> CyclicOutcome:
    timings = Timings(folder / TIMINGS)
    with stage("fitting the hysteretic laws") as progress, timings.measured("choice of the law", once=True):
        choice = choose_model(
            planned.test, planned.laws, planned.error_models, seed=planned.file.seed, folder=folder, progress=progress
        )
    choice.result.to_netcdf(folder / POSTERIOR, predictions=False)
    with stage("predicting") as progress:
        material = CyclicMaterial(
            planned.file.title or planned.file.name,
            study_text(folder / STUDY),
            choice,
            {name: choice.predict(path) for name, path in planned.paths.items()},
            _responses(planned, choice),
        )
    with stage("drawing") as progress:
        page = write_cyclic_report(material, folder, timings.seconds, progress)
    return CyclicOutcome(choice, page, material)


def _responses(planned: PlannedCyclicTest, choice: LawChoice) -> dict[str, PredictedResponse]:
    """Responses of the oscillator with the chosen law to every record."""
    dynamics = planned.file.dynamics
    if dynamics is None:
        return {}
    model = choice.oscillator(dynamics.mass, dynamics.damping_ratio, ("displacement", "restoring_force"))
    draws = choice.result.flat
    chosen = draws[np.linspace(0, len(draws) - 1, dynamics.draws).astype(int), : len(model.free)]
    responses = {}
    for record in planned.records:
        runs = simulate_in_steps_it_needs(model, chosen, record)
        responses[record.name] = PredictedResponse(record.time, runs.values[runs.done], int((~runs.done).sum()))
    return responses
