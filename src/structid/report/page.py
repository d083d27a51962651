"""One self-contained HTML page: first the verdict, then the numbers, then the supporting figures and tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from structid.campaign.runs import Runs
from structid.core.journal import write_then_rename
from structid.core.progress import Progress
from structid.inference.diagnostics.verdict import Verdict
from structid.report import section_list
from structid.report.calibration_overview import derived_table, posterior_table, run_table, sentence
from structid.report.drawing.drawn_sections import DrawnSection, draw
from structid.report.material.certificate_material import CertificateMaterial
from structid.report.material.comparison_material import ComparisonMaterial
from structid.report.material.cyclic_material import CyclicMaterial
from structid.report.material.material import PosteriorMaterial, RunsMaterial
from structid.report.material.programme_material import ProgrammeMaterial
from structid.report.page_summary import ORDER, comparison_summary, cyclic_summary, page_summary
from structid.report.section import NEAREST
from structid.report.tables import percent, versions_table

PAGE = "report.html"
"""File name of a report."""

COMPARISON_PAGE = "comparison.html"
"""File name of a comparison."""


def write_posterior_report(
    material: PosteriorMaterial, drawn: Sequence[DrawnSection], folder: Path, timings: dict[str, float]
) -> Path:
    """Write ``report.html`` of a calibration, with all figures embedded."""
    discrepancy = material.posterior.discrepancy
    return _write(
        "report.html",
        folder,
        title=material.title,
        sentence=sentence(material),
        summary_of_page=page_summary(material),
        verdict=material.result.verdict(),
        cost=material.result.cost,
        calibration=material.calibration,
        nearest=NEAREST,
        doubt=_doubt(material.result.verdict()),
        independent=discrepancy.independent,
        error_model=material.posterior.error_model.describe()["kind"].replace("_", " "),
        has_truth=bool(material.true_values),
        parameters=material.posterior.names,
        exp=np.exp,
        percent=percent,
        main=posterior_table(material),
        derived=derived_table(material),
        runs=material.runs,
        failed_runs=0 if material.runs is None else sum(n for of, n in material.runs.counts.items() if of.run_failed),
        sections=_shown(drawn, material, material.result.verdict().converged),
        settings=material.settings,
        run=run_table(material, timings),
    )


def _doubt(verdict: Verdict) -> str:
    """Warning for the affected tables and figures; empty if the verdict raises no doubt."""
    return verdict.doubt if verdict.converged else "The sampler has not converged: do not use these results"


def write_runs_report(material: RunsMaterial, folder: Path, timings: dict[str, float]) -> Path:
    """Write ``report.html`` of a study that has runs but no measurement."""
    runs = material.runs
    return _write(
        "campaign.html",
        folder,
        title=material.title,
        sentence="A study without a measurement." if runs is None else _what_ran(runs),
        runs=runs,
        sections=_shown(draw(section_list.OF_RUNS, material, folder / "figures"), material),
        settings=material.settings,
        run=versions_table(timings),
    )


def _what_ran(runs: Runs) -> str:
    records = ", ".join(r.name for r in runs.records)
    return f"{len(runs)} runs of a model with the parameters {', '.join(runs.design.names)}, for {records}."


def write_programme_report(
    material: ProgrammeMaterial, folder: Path, timings: dict[str, float], progress: Progress | None = None
) -> Path:
    """Write ``report.html`` of a programme of hybrid tests."""
    programme = material.programme
    return _write(
        "programme.html",
        folder,
        title=material.title,
        sentence=f"{len(programme.tests)} of {len(programme.planned)} hybrid tests on one specimen, which keeps its damage.",
        programme=programme,
        sections=_shown(draw(section_list.OF_A_PROGRAMME, material, folder / "figures", progress), material),
        settings=material.settings,
        run=versions_table(timings),
    )


def write_cyclic_report(
    material: CyclicMaterial, folder: Path, timings: dict[str, float], progress: Progress | None = None
) -> Path:
    """Write ``report.html`` of a cyclic test."""
    choice = material.choice
    believed, further = cyclic_summary(material)
    verdict = choice.result.verdict()
    return _write(
        "cyclic_test.html",
        folder,
        title=material.title,
        sentence=f"The hysteretic law of a specimen from its cyclic test ({len(material.test.force):,} samples).",
        found=[*material.test.questions, choice.sentence],
        believed=believed,
        trust=max((b.trust for b in believed), key=ORDER.index),
        further=further,
        doubt=_doubt(verdict),
        sections=_shown(
            draw(section_list.OF_A_CYCLIC_TEST, material, folder / "figures", progress), material, verdict.converged
        ),
        settings=material.settings,
        run=versions_table(timings),
    )


def write_certificate_report(material: CertificateMaterial, folder: Path, timings: dict[str, float]) -> Path:
    """Write ``report.html`` of a certificate of external draws."""
    return _write(
        "certificate.html",
        folder,
        title=material.title,
        sentence=f"Draws from {material.source}, checked by model runs.",
        certificate=material.certificate,
        sections=_shown(draw(section_list.OF_A_CERTIFICATE, material, folder / "figures"), material),
        settings=material.settings,
        run=versions_table(timings),
    )


def write_comparison(material: ComparisonMaterial, folder: Path, progress: Progress | None = None) -> Path:
    """Write ``comparison.html``: a comparison of model classes of one measurement."""
    believed, further = comparison_summary(material)
    observations, count = material.observations, len(material.classes)
    channels, records = (
        ", ".join(dict.fromkeys(names))
        for names in ((c for o in observations for c in o.channels), (o.record.name for o in observations))
    )
    title = " or ".join(material.names)
    return _write(
        "comparison.html",
        folder,
        page=COMPARISON_PAGE,
        title=f"{title[:1].upper()}{title[1:]}?",
        sentence=f"{count} model classes, compared on the measured {channels} for {records}.",
        verdict=material.comparison.verdict,
        believed=believed,
        further=further,
        best=material.best,
        best_found=page_summary(material.best.material),
        sections=_shown(draw(section_list.OF_A_COMPARISON, material, folder / "figures", progress), material),
        run=versions_table({}),
    )


def _write(name: str, folder: Path, page: str = PAGE, **content: Any) -> Path:
    write_then_rename(folder / page, template(name).render(**content).encode())
    return folder / page


def _shown(drawn: Sequence[DrawnSection], material: Any, converged: bool = True) -> list[dict[str, Any]]:
    """Convert the sections that have content to dictionaries for a template."""
    shown = []
    for drawn_section in drawn:
        section, tables = drawn_section.section, drawn_section.section.tables(material)
        words = section.words(material)
        if not (tables or drawn_section.pictures or words):
            continue
        shown.append(
            {
                "key": section.key,
                "title": section.title,
                "words": words,
                "tables": tables,
                "pictures": drawn_section.pictures,
                "under_doubt": section.under_doubt if converged or section.of_draws else "",
            }
        )
    return shown


def template(name: str) -> jinja2.Template:
    """Load a template of a page."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("structid", "report/templates"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template(name)
