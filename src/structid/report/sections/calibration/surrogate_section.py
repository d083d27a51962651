"""The surrogate: its settings and its validation."""

from __future__ import annotations

import functools
from typing import Any

from structid.figures.style import pretty
from structid.report.material.material import RunsMaterial
from structid.report.section import Drawing, Picture, Rows, Section, Table
from structid.surrogates.base import Surrogate
from structid.surrogates.surrogate_validation import Validation


def _in_words(setting: Any) -> str:
    if isinstance(setting, dict):
        return ", ".join(f"{pretty(k)} {_in_words(v)}" for k, v in setting.items() if v is not None)
    return ", ".join(map(str, setting)) if isinstance(setting, (list, tuple)) else str(setting)


def _validation(surrogate: Surrogate) -> Rows:
    """Errors of a surrogate on its validation runs, one row per channel."""
    validation = surrogate.validation
    assert validation is not None
    heads = ["channel", "mean error", "median", "95 %", "worst", "diverged", "peak error", "within 1.96 sd"]
    rows = [
        [
            pretty(channel),
            *(f"{errors[k]:.2g}" for k in ("mean", "median", "q95", "worst")),
            f"{validation.diverged} of {len(validation.errors)}",
            f"{validation.peak_error:.2%}",
            f"{validation.coverage:.1%}",
        ]
        for channel, errors in validation.per_channel.items()
    ]
    return heads, rows


def _what_it_is(surrogate: Surrogate) -> Rows:
    """Settings of a surrogate, and its training runs."""
    fit = surrogate.fitted
    # In a calibration, the certificate assesses the surrogate near the posterior.
    over = "over all its runs, even far from the posterior" if surrogate.trusted else "estimated during the fit"
    rows = [
        ["kind", surrogate.kind_in_words],
        ["fitted to", f"{fit.runs} runs ({fit.left_out} other runs excluded), in {fit.seconds:.1f} s"],
        [f"mean error {over}", f"{fit.error:.2g}"],
    ]
    source = "estimated during the fit"
    if surrogate.validation is not None:
        validation, source = surrogate.validation, "on the validation runs"
        rows += [
            ["mean error on the validation runs", f"{validation.mean:.2g}"],
            ["validation runs outside the training range", f"{validation.outside} of {len(validation.errors)}"],
        ]
    if not surrogate.trusted:
        rows.append(["largest mean error for sampling", f"{fit.limit:g} ({source})"])
    rows += [[name, value] for name, value in surrogate.structure_in_words]
    shown = {k: v for k, v in fit.settings.items() if k not in ("limit", "outside") and v not in (None, [])}
    rows += [[pretty(k), _in_words(v)] for k, v in shown.items()]
    return ["", ""], rows


def _tables(material: RunsMaterial) -> list[Table]:
    surrogate = material.results.get(Surrogate)
    if surrogate is None:
        return []
    validation = [] if surrogate.validation is None else [Table("Validation", _validation(surrogate))]
    return [*validation, Table("Settings and fit", _what_it_is(surrogate), of_words=True)]


def _drawings(material: RunsMaterial) -> list[Drawing]:
    surrogate = material.results.get(Surrogate)
    validation = None if surrogate is None else surrogate.validation
    return [] if validation is None else [functools.partial(_channel, validation, c) for c in validation.channels]


def _channel(validation: Validation, channel: str) -> Picture:
    name = f"surrogate_{channel}"
    return Picture(
        name,
        f"The surrogate's {channel} and model runs that were not used in the fit: the histories with the smallest, median and "
        "largest error; peaks; samples; and the distribution of the error.",
        validation.plot(channel),
    )


SECTION = Section("surrogate", "Surrogate", _drawings, _tables)
