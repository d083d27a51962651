"""Numbers of a report with appropriate digits, and tables that several pages share."""

from __future__ import annotations

import importlib
import platform

import numpy as np
from jaxtyping import Float

from structid.core.channels import standard_unit
from structid.core.units import factor
from structid.figures.style import pretty_unit
from structid.report.section import Rows

NOTHING = 1e-3
"""A number smaller than this fraction of its uncertainty is shown as zero."""


def number(value: float, error: float | None = None) -> str:
    """Format a number with two digits of its uncertainty, or with four significant digits."""
    if not np.isfinite(value):
        return "–"
    if error is None or not np.isfinite(error) or error <= 0:
        return f"{value:.4g}"
    digits = int(np.clip(1 - np.floor(np.log10(error)), 0, 12))
    if abs(value) < error * NOTHING:
        return "0"
    magnitude = max(abs(value), error)
    return f"{value:.{digits}f}" if 1e-4 <= magnitude < 1e6 else f"{value:.4g}"


def moments(
    values: Float[np.ndarray, "draw ..."], weights: Float[np.ndarray, " draw"] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mean, standard deviation, and 5 and 95 % quantiles of draws."""
    mean = np.average(values, axis=0, weights=weights)
    sd = np.sqrt(np.average((values - mean) ** 2, axis=0, weights=weights))
    low, high = np.quantile(values, [0.05, 0.95], axis=0, weights=weights, method="inverted_cdf")
    return mean, sd, low, high


def percent(share: float) -> str:
    """Format a fraction in per cent, with two digits."""
    value = 100.0 * share
    return f"{value:.0f} %" if abs(value) >= 10.0 else f"{value:.2g} %"


def in_display_unit(value: float, channel: str) -> str:
    """Format a value of a channel in its display unit."""
    unit = standard_unit(channel).display
    return f"{value / factor(unit):g} {pretty_unit(unit)}".strip()


def lines_without_markers(text: str) -> list[str]:
    """Return one paragraph for each line, without list markers."""
    return [line.strip().removeprefix("- ").removeprefix("! ") for line in text.splitlines()]


def file_name(title: str) -> str:
    """Return a name for a file from a title, with only letters, digits and underscores."""
    return "".join(letter if letter.isalnum() else "_" for letter in title)


def versions_table(timings: dict[str, float]) -> Rows:
    """Durations of the stages, versions and machine."""
    rows = [
        *([f"time: {stage}", f"{seconds:.1f} s"] for stage, seconds in timings.items()),
        [
            "versions",
            ", ".join(f"{n} {importlib.metadata.version(n)}" for n in ("structid", "jax", "numpy", "scipy")),
        ],
        ["machine", f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"],
    ]
    return ["item", "value"], rows
