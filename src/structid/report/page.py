"""One self-contained HTML page: the verdict first, then the numbers, then what they rest on."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

import jinja2
import numpy as np

from structid.figures import response as response_figures
from structid.inference.assessment.comparison import Comparison
from structid.inference.assessment.prediction import Prediction
from structid.inference.likelihood.observation import Observation
from structid.journal import write_then_rename
from structid.report import tables
from structid.report.content import RUNS_CAPTION, ReportContent, draw_surrogate
from structid.runs import Runs
from structid.surrogates.face import Surrogate
from structid.units import factor

PAGE = "report.html"
"""File of a report."""

_SECTIONS = {
    "calibration": "Certificate",
    "response": "Response",
    "residuals": "Residuals",
    "posterior": "Posterior",
    "deterministic": "Deterministic calibration beside it",
    "other records": "Other records",
    "convergence": "Convergence",
    "surrogate": "Surrogate",
    "true runs": "True runs",
    "data": "Data",
}


def write_report(content: ReportContent, folder: Path, timings: dict[str, float]) -> Path:
    """Write ``report.html`` with every figure inside it.

    Parameters
    ----------
    content : ReportContent
        Drawn into ``folder/figures``.
    folder : Path
        Where the page goes.
    timings : dict of str to float
        Seconds of every stage.

    Returns
    -------
    Path
        The page.
    """
    verdict = content.result.verdict()
    figures = {
        section: [
            (name, caption, _embedded(folder / "figures" / f"{name}.png"))
            for s, name, caption in content.figures
            if s == section
        ]
        for section in _SECTIONS
    }
    page = _template("report.html").render(
        title=content.title,
        verdict=verdict,
        cost=content.result.cost,
        too_sure=content.posterior.discrepancy.independent and any(r.correlated for r in content.result.residuals),
        calibration=content.calibration,
        exp=np.exp,
        parameters=content.posterior.names,
        sections=_SECTIONS,
        figures=figures,
        settings=content.settings,
        sentence=_sentence(content),
        information=content.information,
        independent=content.posterior.discrepancy.independent,
        law=content.posterior.discrepancy.describe()["kind"].replace("_", " "),
        has_truth=bool(content.true_values),
        tables={
            "calibration": tables.calibration_tables(content.calibration),
            "response": [],
            "residuals": [],
            "posterior": [
                ("Identifiability at the MAP estimate", tables.identifiability_table(content)),
                ("Priors", tables.prior_table(content)),
            ],
            "deterministic": [("Minima", tables.deterministic_table(content))] if content.searches else [],
            "other records": [("Peak response", tables.others_table(content))],
            "convergence": [("Diagnostics", tables.convergence_table(content))],
            "surrogate": surrogate_tables(content.surrogate),
            "true runs": [("How they ended", tables.runs_table(content.runs))] if content.runs is not None else [],
            "data": [],
        },
        main=tables.posterior_table(content),
        run=tables.run_table(content, timings),
    )
    write_then_rename(folder / PAGE, page.encode())
    return folder / PAGE


def surrogate_tables(surrogate: Surrogate | None) -> list[tuple[str, tables.Table]]:
    """Tables of a surrogate, with what they are called.

    Parameters
    ----------
    surrogate : Surrogate or None
        What stood in for the model, if anything did.

    Returns
    -------
    list of tuple
        Captions and tables.
    """
    if surrogate is None or surrogate.validation is None:
        return []
    return [("Validation", tables.validation_table(surrogate)), ("What it is", tables.surrogate_table(surrogate))]


def write_campaign_report(
    runs: Runs, title: str, settings: str, folder: Path, timings: dict[str, float], surrogate: Surrogate | None = None
) -> Path:
    """Write ``report.html`` of a study that has runs and nothing measured.

    Parameters
    ----------
    runs : Runs
        The campaign's.
    title, settings : str
        Title, and the study file's text.
    folder : Path
        Where the page goes.
    timings : dict of str to float
        Seconds of every stage.
    surrogate : Surrogate, optional
        What was fitted to the runs.

    Returns
    -------
    Path
        The page.
    """
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    runs.plot(folder / "figures" / "runs")
    records = ", ".join(r.name for r in runs.records)
    page = _template("campaign.html").render(
        title=title,
        sentence=f"{len(runs)} runs of a model with the parameters {', '.join(runs.design.names)} on {records}.",
        runs=runs,
        ended=tables.runs_table(runs),
        surrogate=surrogate_tables(surrogate),
        surrogate_figures=_surrogate_figures(surrogate, folder / "figures"),
        overview=("runs", RUNS_CAPTION, _embedded(folder / "figures" / "runs.png")),
        settings=settings,
        run=tables.versions_table(timings),
    )
    write_then_rename(folder / PAGE, page.encode())
    return folder / PAGE


def write_comparison(
    comparison: Comparison, predictions: Sequence[Prediction], observation: Observation, folder: Path
) -> Path:
    """Write ``comparison.html``: model classes side by side.

    Parameters
    ----------
    comparison : Comparison
        Their figures.
    predictions : sequence of Prediction
        Of the first measurement, in the order of the classes.
    observation : Observation
        The first measurement.
    folder : Path
        Where the page goes; made if it is not there.

    Returns
    -------
    Path
        The page.
    """
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    classes, figures = [c.name for c in comparison.classes], []
    for c, channel in enumerate(observation.channels):
        unit, name = observation.channel_unit(channel).display, f"predictions_{channel}"
        by = factor(unit)

        def edges(prediction: Prediction, discrepancy: bool) -> tuple[np.ndarray, np.ndarray]:
            low, high = prediction.band(discrepancy=discrepancy)
            return low[:, c] / by, high[:, c] / by  # noqa: B023

        inner, outer = [edges(p, False) for p in predictions], [edges(p, True) for p in predictions]
        response_figures.side_by_side(
            observation.record.time, observation.values[:, c] / by, inner, outer, classes, channel, unit,
            save=folder / "figures" / name,
        )  # fmt: skip
        caption = (
            f"Measured {channel} on {observation.record.name} around its peak, and what each class predicts of it."
        )
        figures.append((name, caption, _embedded(folder / "figures" / f"{name}.png")))
    page = _template("comparison.html").render(
        title=" or ".join(classes),
        sentence=f"{len(classes)} model classes of one measurement.",
        comparison=comparison,
        content=comparison.side_by_side(),
        figures=figures,
        run=tables.versions_table({}),
    )
    write_then_rename(folder / "comparison.html", page.encode())
    return folder / "comparison.html"


def _surrogate_figures(surrogate: Surrogate | None, folder: Path) -> list[tuple[str, str, str]]:
    if surrogate is None or surrogate.validation is None:
        return []
    drawn = draw_surrogate(surrogate, folder)
    return [(name, caption, _embedded(folder / f"{name}.png")) for name, caption in drawn]


def _template(name: str) -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("structid", "report/templates"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template(name)


def _embedded(path: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()


def _sentence(content: ReportContent) -> str:
    """Say in one sentence what was done."""
    posterior = content.posterior
    kind = content.model.kind_in_words
    through = f", through a {content.surrogate.fitted.kind} surrogate," if content.surrogate is not None else ""
    records = ", ".join(o.record.name for o in posterior.observations)
    channels = ", ".join(dict.fromkeys(c for o in posterior.observations for c in o.channels))
    return (
        f"{len(posterior.model_space.names)} parameters of a {kind}{through} calibrated against the measured "
        f"{channels} on {records} ({sum(o.values.size for o in posterior.observations):,} values)."
    )
