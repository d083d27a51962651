"""Probability of a passage or a failure, given the data, for records of increasing strength."""

from __future__ import annotations

import functools

import numpy as np

from structid.figures.style import pretty
from structid.reliability.fragility import Fragility
from structid.report.material.material import PosteriorMaterial
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.tables import in_display_unit


def _limit(fragility: Fragility) -> str:
    return f"{in_display_unit(fragility.limit, fragility.channel)} of {pretty(fragility.channel)}"


def _tables(material: PosteriorMaterial) -> list[Table]:
    result = material.results.get(Fragility)
    if result is None:
        return []
    low, high = result.band()
    rows = [
        [f"{level:g}", f"{p:.3f} ± {error:.3f}", f"{a:.2f} to {b:.2f}", *(f"{each:.2f}" for each in of_each)]
        for level, p, error, a, b, of_each in zip(
            result.levels, result.probability, result.error, low, high, result.of_each.T, strict=True
        )
    ]
    shown = result.records if len(result.records) <= MOST_RECORDS else ()
    heads = ["peak ground acceleration [m/s²]", "probability", "90 % of the draws", *shown]
    caption = f"Probability of exceeding {_limit(result)}, or of failure"
    return [Table(caption, (heads, [row[: len(heads)] for row in rows]))]


MOST_RECORDS = 4
"""Largest number of records for which the table has one column per record."""


def _words(material: PosteriorMaterial) -> list[str]:
    result = material.results.get(Fragility)
    if result is None:
        return []
    count = len(result.records)
    words = [
        f"{result.passed.shape[0]} posterior draws for {count} record{'s' if count > 1 else ''}, {result.true_runs:,} model runs. "
        "The standard error includes the scatter over the records, the number of draws and, if a surrogate was used, its "
        "correction. For these records, the band over the draws shows the remaining uncertainty about the structure."
    ]
    median, dispersion = result.curve
    errors = result.curve_error
    if np.isfinite(median):
        fitted = f"The fitted curve Φ(ln(a/θ)/β) has θ = {median:.3g} m/s² and β = {dispersion:.2f}"
        if np.isfinite(errors[0]):
            fitted += f", with standard errors of {errors[0]:.0%} and {errors[1]:.2f} from resampling of the records and draws"
        words.append(fitted + ".")
    return words


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    return [] if (result := material.results.get(Fragility)) is None else [functools.partial(_drawn, result)]


def _drawn(fragility: Fragility) -> Picture:
    return Picture(
        "fragility", f"Probability of exceeding {_limit(fragility)}, or of failure, given the data.", fragility.plot()
    )


SECTION = Section(
    "fragility",
    "Probability of failure",
    _drawings,
    _tables,
    _words,
    "This probability comes from a model that is wrong for these data. It allows for the model errors in the measured channels, "
    "as estimated from the measured record.",
)
