"""Predictions for unmeasured records."""

from __future__ import annotations

import functools

from structid.core.units import STANDARD_GRAVITY, label
from structid.figures.style import pretty_unit
from structid.report.material.material import PosteriorMaterial
from structid.report.material.predicted_records import PredictedRecord, names_of_failing_records, predicted_records
from structid.report.section import Drawing, Picture, Section, Table


def _tables(material: PosteriorMaterial) -> list[Table]:
    rows = [
        [
            other.name,
            f"{other.record.pga / STANDARD_GRAVITY:.3g}",
            label(peak.channel, pretty_unit(peak.unit)),
            *peak.cells,
        ]
        for other in predicted_records(material)
        for peak in other.peaks()
    ]
    heads = [
        "record",
        "PGA [g]",
        "peak of",
        "5 %",
        "median",
        "95 %",
        *([] if material.truths[0] is None else ["truth"]),
    ]
    return [Table("Peak response", (heads, rows))] if rows else []


def _words(material: PosteriorMaterial) -> list[str]:
    if not material.other_records:
        return []
    failing = [
        f"The model fails under the record {name}: no prediction." for name in names_of_failing_records(material)
    ]
    if not predicted_records(material):
        return failing
    words = [
        *failing,
        "The predicted peak is the peak of the structure: it includes the model error, but not the instrument noise. The inner "
        "band shows the model response only. The outer band shows the expected reading of an instrument.",
    ]
    band = predicted_records(material)[0].band
    if band.peak_ratio is None or (band.peak_ratio == 1.0).all():
        return words
    ratios = [f"{ratio:.2f} ({name})" for name, ratio in zip(band.channels, band.peak_ratio, strict=True)]
    return [
        *words,
        f"For the measured record, the measured peak is {', '.join(ratios)} times the predicted peak. One record cannot show "
        "whether other peaks have the same error. The bands of the peaks therefore cover the range from no such error to the full "
        "error.",
    ]


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    return [
        functools.partial(_band, other, number_of_it, column)
        for number_of_it, other in enumerate(predicted_records(material), start=1)
        for column in range(len(other.channels))
    ]


def _band(other: PredictedRecord, number_of_it: int, column: int) -> Picture:
    band = other.band
    channel = band.channels[column]
    name = f"other_{number_of_it}_{channel}"
    truth, held = other.truth, other.inside(column)
    reference = None if truth is None else ("truth of the virtual experiment", truth[:, column])
    figure = band.draw(column, band.units[channel].display, reference)
    sentence = (
        ""
        if held is None
        else f" The outer band contains {100 * held:.0f} % of the true history of the virtual experiment."
    )
    return Picture(name, f"Predicted {channel} for {other.name}.{sentence}", figure)


SECTION = Section(
    "other-records",
    "Other records",
    _drawings,
    _tables,
    _words,
    "The bands allow for the drift of the parameters, and for errors that grow with the response as in the measured record. "
    "They need not contain the response to a very different record, for example a much stronger earthquake.",
)
