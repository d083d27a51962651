"""The page of a comparison: model classes side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from structid.figures import response as response_figures
from structid.inference.assessment.comparison import Comparison
from structid.inference.assessment.prediction import Prediction
from structid.journal import write_then_rename
from structid.observation import Observation
from structid.report.page import embedded, template
from structid.report.tables import versions_table
from structid.units import factor

COMPARISON_PAGE = "comparison.html"
"""File of a comparison."""


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
        figures.append((name, caption, embedded(folder / "figures" / f"{name}.png")))
    page = template("comparison.html").render(
        title=" or ".join(classes),
        sentence=f"{len(classes)} model classes of one measurement.",
        comparison=comparison,
        content=comparison.side_by_side(),
        figures=figures,
        run=versions_table({}),
    )
    write_then_rename(folder / COMPARISON_PAGE, page.encode())
    return folder / COMPARISON_PAGE
