"""Run a programme of hybrid tests, from the programme file to the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from structid.core.errors import InputError
from structid.hybrid.experiment import HybridTest
from structid.hybrid.feasibility import Feasibility
from structid.hybrid.programme import ProgrammeResult, store_of
from structid.hybrid.recording.result_file import open_hybrid
from structid.report.material.programme_material import Learnt, ProgrammeMaterial
from structid.report.page import write_programme_report
from structid.study.folder_layout import INPUTS, POSTERIOR, STUDY, TIMINGS
from structid.study.kept_inputs import claim_for_text, kept_content
from structid.study.programmes.learnt_of_tests import learnt_of
from structid.study.programmes.planned_programme import PlannedProgramme, planned
from structid.study.programmes.programme_file import parse_programme, read_programme
from structid.study.schema.study_file import study_text
from structid.study.timings import Stage, Timings, silent


@dataclass(frozen=True, eq=False)
class ProgrammeOutcome:
    """Outcome of a programme."""

    programme: ProgrammeResult  # results of the tests
    learnt: Learnt | None  # posterior and prediction
    report: Path  # path of the page


def load_programme(path: str | Path) -> PlannedProgramme:
    """Read a programme file and build the programme."""
    programme = planned(read_programme(path), Path(path).resolve().parent)
    if programme.file.learning is not None or programme.file.online is not None:
        programme.learnable()
        programme.known_sd()
    return programme


def run_programme(
    path: str | Path,
    out: str | Path,
    *,
    address: str = "",
    secret: str | Callable[[], str] = "",
    resume: bool = False,
    stage: Stage = silent,
    watching: Callable[[str, HybridTest], None] | None = None,
) -> ProgrammeOutcome:
    """Run a programme of hybrid tests."""
    programme, folder = load_programme(path), Path(out)
    specimen = programme.laboratory(address, secret) if address else None
    claim_for_text(folder, Path(path), resume, "programme")
    timings = Timings(folder / TIMINGS)
    with timings.measured("tests"):
        tests = programme.programme(specimen).run(folder, resume=resume, watching=watching)
    return _learn_and_report(programme, tests, folder, timings, stage)


def programme_report_again(folder: str | Path, stage: Stage = silent) -> ProgrammeOutcome:
    """Rewrite the report from stored results."""
    folder = Path(folder)
    programme = planned(parse_programme(kept_content(folder), str(folder / STUDY)), folder / INPUTS)
    names = [section.name for section in programme.file.test]
    tests = {name: open_hybrid(store_of(folder, name)) for name in names if store_of(folder, name).exists()}
    if not tests:
        raise InputError(f"{folder}", "no test", "an output folder of structid hybrid")
    return _learn_and_report(programme, ProgrammeResult(tests, tuple(names)), folder, Timings(folder / TIMINGS), stage)


def check_programme(
    path: str | Path, address: str = "", secret: str | Callable[[], str] = ""
) -> dict[str, Feasibility]:
    """Check every test of a programme; nothing moves."""
    programme = load_programme(path)
    return programme.programme(programme.laboratory(address, secret) if address else None).check()


def _learn_and_report(
    programme: PlannedProgramme, tests: ProgrammeResult, folder: Path, timings: Timings, stage: Stage
) -> ProgrammeOutcome:
    """Compute the posterior from the tests, and write the page."""
    with timings.measured("learning"):
        learnt = learnt_of(programme, tests, folder, stage)
    if learnt is not None:
        learnt.result.to_netcdf(folder / POSTERIOR, predictions=False)
    text = study_text(folder / STUDY)
    title = programme.file.title or programme.file.name
    material = ProgrammeMaterial(title, text, tests, learnt, _true_values(programme, tests))
    with stage("drawing") as progress:
        page = write_programme_report(material, folder, timings.seconds, progress)
    return ProgrammeOutcome(tests, learnt, page)


def _true_values(programme: PlannedProgramme, tests: ProgrammeResult) -> dict[str, float]:
    """True parameters of a simulated specimen, if the calibrated model has the same type."""
    file = programme.file
    simulated = all(test.description.simulated for test in tests.tests.values())
    if not simulated or file.model is None or file.model.type != file.specimen.model.type:
        return {}
    given: dict[str, Any] = file.specimen.model.model_dump()
    return {name: given[name] for name in file.parameters if isinstance(given.get(name), float)}
