"""Figure of a campaign: the responses of its runs, and the failed runs in parameter space."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from structid.figures.style import ACCENT, MODEL, MUTED, canvas, finish, name_axes, pretty, pretty_unit, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 400
"""Largest number of runs used for the bands, to limit memory."""


@styled
def overview(
    time: Float[np.ndarray, " time"],
    values: Float[np.ndarray, "run time channel"],
    channels: tuple[str, ...],
    units: tuple[str, ...],
    theta: Float[np.ndarray, "design_point parameter"],
    names: tuple[str, ...],
    parameter_units: tuple[str, ...],
    status: Int[np.ndarray, " design_point"],
    words: dict[int, str],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw bands of the responses, and the design next to them."""
    rows = max(len(channels), 1)
    figure, axes = canvas(rows, 2, height=2.4 if rows > 1 else 2.9, width_ratios=(1.6, 1.0))
    for axis, channel, unit, histories in zip(axes[:, 0], channels, units, np.moveaxis(values, 2, 0), strict=True):
        _bands(axis, time, histories)
        name_axes(axis, ("time", "s"), (pretty(channel), pretty_unit(unit)))
    for axis in axes[1:, 1]:
        axis.remove()
    _design(axes[0, 1], theta, names, parameter_units, status, words)
    return finish(figure, save=save)


def _bands(axis: Any, time: np.ndarray, histories: np.ndarray) -> None:
    if len(histories) == 0:
        axis.text(0.5, 0.5, "no finished run", transform=axis.transAxes, ha="center", color=MUTED)
        return
    low, quarter, middle, three_quarters, high = np.quantile(histories, [0.05, 0.25, 0.5, 0.75, 0.95], axis=0)
    axis.fill_between(time, low, high, color=ACCENT, alpha=0.18, lw=0, label="90 %")
    axis.fill_between(time, quarter, three_quarters, color=ACCENT, alpha=0.35, lw=0, label="50 %")
    axis.plot(time, middle, color=ACCENT, lw=0.8, label="median")
    axis.legend(ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))


def _design(
    axis: Any,
    theta: np.ndarray,
    names: tuple[str, ...],
    units: tuple[str, ...],
    status: np.ndarray,
    words: dict[int, str],
) -> None:
    """Scatter plot of the two parameters that best separate failed from finished runs; the first two if no run failed."""
    first, second = _most_separating(theta, status)
    if second is None:
        theta, names, units = np.column_stack([theta, np.arange(len(theta))]), (*names, "run"), (*units, "")
        second = theta.shape[1] - 1
    colours = {0: ACCENT, 1: MODEL, 2: "#1a1a1a", 3: "#bc8034", 4: MUTED, 5: "#7b4fa3"}
    for code in np.unique(status):
        some = status == code
        axis.scatter(
            theta[some, first],
            theta[some, second],
            s=7 if code == 0 else 14,
            lw=0,
            color=colours[int(code)],
            alpha=0.5 if code == 0 else 0.9,
            label=f"{words[int(code)]} ({some.sum()})",
            zorder=2 + int(code > 0),
        )
    name_axes(axis, *((pretty(names[i]), pretty_unit(units[i])) for i in (first, second)))
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, handletextpad=0.1, columnspacing=1.0)


def _most_separating(theta: np.ndarray, status: np.ndarray) -> tuple[int, int | None]:
    """The two parameters with the largest difference between the means of failed and finished runs, in standard deviations."""
    if theta.shape[1] < 2:
        return 0, None
    failed = (status != 0) & (status != 4)
    if not failed.any() or failed.all():
        return 0, 1
    difference = np.abs(theta[failed].mean(axis=0) - theta[~failed].mean(axis=0)) / (theta.std(axis=0) + 1e-300)
    order = np.argsort(-difference)
    return int(order[0]), int(order[1])
