"""Section of a comparison: predictions of all model classes for unmeasured records."""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.core.units import factor, label
from structid.figures import response as figures
from structid.figures.style import pretty_unit
from structid.report.material.comparison_material import ComparisonMaterial
from structid.report.material.predicted_records import PredictedRecord, predicted_records
from structid.report.section import Drawing, Picture, Section, Table

TRUTH = "truth of the virtual experiment"


def _together(material: ComparisonMaterial) -> list[tuple[PredictedRecord, ...]]:
    """Predictions for one record by all classes; records and channels that all classes have, in the order of the first class."""
    every = [{(p.name, p.channels): p for p in predicted_records(one.material)} for one in material.classes]
    return [tuple(of_one[key] for of_one in every) for key in every[0] if all(key in of_one for of_one in every)]


def _tables(material: ComparisonMaterial) -> list[Table]:
    rows, has_truth = [], False
    for together in _together(material):
        for name, predicted in zip(material.names, together, strict=True):
            for column, peak in enumerate(predicted.peaks()):
                held = predicted.inside(column)
                has_truth = has_truth or held is not None
                cells = [*peak.cells, *([] if held is None else [f"{100 * held:.0f} %"])]
                rows.append([predicted.name, name, label(peak.channel, pretty_unit(peak.unit)), *cells])
    heads = [
        "record",
        "class",
        "peak of",
        "5 %",
        "median",
        "95 %",
        *(["truth", "true history inside"] if has_truth else []),
    ]
    return (
        [
            Table(
                "Peak response, and fraction of the true history inside the outer 90 % band"
                if has_truth
                else "Peak response",
                (heads, rows),
            )
        ]
        if rows
        else []
    )


def _drawings(material: ComparisonMaterial) -> list[Drawing]:
    return [
        partial(_draw, material.names, together, number, column)
        for number, together in enumerate(_together(material), start=1)
        for column in range(len(together[0].channels))
    ]


def _draw(names: list[str], together: tuple[PredictedRecord, ...], number: int, column: int) -> Picture:
    band = together[0].band
    channel = band.channels[column]
    unit = band.units[channel].display

    def of_channel(edges: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        low, high = edges
        return low[:, column] / factor(unit), high[:, column] / factor(unit)

    truth = together[0].truth
    figure = figures.side_by_side(
        band.time,
        None if truth is None else truth[:, column] / factor(unit),
        [of_channel(p.band.inner) for p in together],
        [of_channel(p.band.outer) for p in together],
        names,
        channel,
        unit,
        TRUTH,
    )
    against = "" if truth is None else f", and the {TRUTH}, which no calibration used"
    caption = f"Predicted {channel} for {together[0].name} around its peak{against}."
    return Picture(f"other_{number}_{channel}", caption, figure)


SECTION: Section[ComparisonMaterial] = Section("other-records", "Other records", _drawings, _tables)
