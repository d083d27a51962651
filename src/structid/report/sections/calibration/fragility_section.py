"""The probability of a passage or a failure, given the data, for records of increasing strength."""

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
    return [Table(f"Probability of passing {_limit(result)}, or of failing", (heads, [r[: len(heads)] for r in rows]))]


MOST_RECORDS = 4
"""Number of records up to which each has a column."""


def _words(material: PosteriorMaterial) -> list[str]:
    result = material.results.get(Fragility)
    if result is None:
        return []
    count = len(result.records)
    words = [
        f"{result.passed.shape[0]} draws of the posterior on {count} record{'s' if count > 1 else ''}, {result.true_runs:,} true "
        "runs. The error is that of the records' scatter and of the draws, and of a surrogate's correction where one stood in. "
        "The band over the draws is what the data leave open about the structure; it is for these records."
    ]
    median, dispersion = result.curve
    errors = result.curve_error
    if np.isfinite(median):
        fitted = f"The fitted curve Φ(ln(a/θ)/β) has θ = {median:.3g} m/s² and β = {dispersion:.2f}"
        if np.isfinite(errors[0]):
            fitted += (
                f", with standard errors of {errors[0]:.0%} and {errors[1]:.2f} by resampling of records and draws"
            )
        words.append(fitted + ".")
    return words


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    return [] if (result := material.results.get(Fragility)) is None else [functools.partial(_drawn, result)]


def _drawn(fragility: Fragility) -> Picture:
    return Picture(
        "fragility", f"Probability of passing {_limit(fragility)}, or of failing, given the data.", fragility.plot()
    )


SECTION = Section(
    "fragility",
    "Probability of failure",
    _drawings,
    _tables,
    _words,
    "The probability is that of a model that is wrong for these data. It allows for the errors that it made on the measured "
    "record, in the channels that were measured.",
)
