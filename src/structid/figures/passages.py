"""Figures of first passages in the runs of a design: passage times against parameters, probabilities, distributions, indices."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from structid.figures.style import ACCENT, CYCLE, MODEL, MUTED, canvas, finish, name_axes, pretty, pretty_unit, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 4000
"""Largest number of runs drawn as points."""
_LATE_TO_EARLY = "viridis_r"


@styled
def times(
    points: Float[np.ndarray, "run parameter"],
    names: Sequence[str],
    units: Sequence[str],
    time: Float[np.ndarray, " run"],
    end: float,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot the first-passage times against each parameter."""
    columns = min(len(names), 4)
    rows = -(-len(names) // columns)
    figure, axes = canvas(rows, columns, height=2.1, sharey=True)
    some, passed = _some(len(time)), np.isfinite(time)
    above = end * 1.06
    for axis in axes.ravel()[len(names) :]:
        axis.remove()
    for number, (axis, column) in enumerate(zip(axes.ravel(), points.T, strict=False)):
        here, none = some[passed[some]], some[~passed[some]]
        axis.plot(column[none], np.full(len(none), above), "|", ms=4, mew=0.5, color=MUTED, label="none")
        axis.plot(column[here], time[here], ".", ms=2.5, mew=0, color=MODEL, alpha=0.6, label="first passage")
        axis.axhline(end, color=MUTED, lw=0.8)
        name_axes(axis, (pretty(names[number]), pretty_unit(units[number])), ("", ""))
        axis.set_ylim(0.0, end * 1.12)
        axis.locator_params(axis="x", nbins=4)
    for row in axes:
        row[0].set_ylabel("first passage [s]")
    return finish(figure, title, save)


@styled
def pairs(
    points: Float[np.ndarray, "run parameter"],
    names: Sequence[str],
    units: Sequence[str],
    time: Float[np.ndarray, " run"],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw maps of the first-passage times over every pair of parameters."""
    both = list(combinations(range(len(names)), 2))
    columns = min(len(both), 3)
    figure, axes = canvas(-(-len(both) // columns), columns, height=2.2)
    some, passed = _some(len(time)), np.isfinite(time)
    here, none = some[passed[some]], some[~passed[some]]
    for axis in axes.ravel()[len(both) :]:
        axis.remove()
    drawn = None
    for axis, (x, y) in zip(axes.ravel(), both, strict=False):
        axis.plot(points[none, x], points[none, y], ".", ms=2.0, mew=0, color=MUTED, alpha=0.5)
        drawn = axis.scatter(points[here, x], points[here, y], s=4, lw=0, c=time[here], cmap=_LATE_TO_EARLY)
        name_axes(axis, *((pretty(names[i]), pretty_unit(units[i])) for i in (x, y)))
    if drawn is not None and len(here):
        bar = figure.colorbar(drawn, ax=list(axes.ravel()[: len(both)]), shrink=0.6, aspect=30)
        bar.set_label("first passage [s]; grey: none")
    return finish(figure, title, save)


@styled
def probability_map(
    points: Float[np.ndarray, "run 2"],
    names: Sequence[str],
    units: Sequence[str],
    passed: Bool[np.ndarray, " run"],
    predicted: Float[np.ndarray, " run"],
    probability: Callable[[np.ndarray, np.ndarray], np.ndarray],
    levels: Sequence[float] = (0.05, 0.5, 0.95),
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot the passage probability over two parameters, and its mean and the observed fractions along the first of them."""
    figure, axes = canvas(1, 2, height=2.9)
    some = _some(len(passed))
    axis, beside = axes[0]
    for which, colour, label in ((~passed, MUTED, "no passage"), (passed, MODEL, "passage")):
        rows = some[which[some]]
        axis.plot(points[rows, 0], points[rows, 1], ".", ms=2.5, mew=0, color=colour, alpha=0.7, label=label)
    x, y = (np.linspace(column.min(), column.max(), 80) for column in points.T)
    grid = np.meshgrid(x, y)
    axis.contour(x, y, probability(*grid), levels=list(levels), colors=ACCENT, linewidths=(0.7, 1.4, 0.7))
    axis.plot([], [], color=ACCENT, lw=1.4, label=f"P {', '.join(f'{level:g}' for level in levels)}")
    axis.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, markerscale=3, handletextpad=0.3, columnspacing=1.0
    )
    name_axes(axis, *((pretty(n), pretty_unit(u)) for n, u in zip(names, units, strict=True)))
    parts = np.array_split(np.argsort(points[:, 0]), 40)
    beside.plot(
        [points[part, 0].mean() for part in parts],
        [passed[part].mean() for part in parts],
        "o",
        ms=3,
        mew=0,
        color=MODEL,
        label="observed fraction",
    )
    beside.plot(
        [points[part, 0].mean() for part in parts],
        [predicted[part].mean() for part in parts],
        color=ACCENT,
        lw=1.2,
        label="mean of P",
    )
    beside.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    name_axes(beside, (pretty(names[0]), pretty_unit(units[0])), ("probability of a passage", ""))
    return finish(figure, title, save)


@styled
def distributions(
    time: Float[np.ndarray, " time"],
    curves: Sequence[tuple[str, np.ndarray, np.ndarray]],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the probability of a passage as a function of time."""
    figure, axes = canvas(1, 1, height=2.6)
    axis = axes[0, 0]
    for number, (label, probability, error) in enumerate(curves):
        colour = CYCLE[number % len(CYCLE)]
        axis.plot(time, probability, color=colour, lw=1.2, label=label, drawstyle="steps-post")
        axis.fill_between(
            time, probability - 2.0 * error, probability + 2.0 * error, color=colour, alpha=0.2, lw=0, step="post"
        )
    axis.legend(loc="upper left")
    axis.set_ylim(bottom=0.0)
    name_axes(axis, ("time", "s"), ("fraction of the runs that have passed", ""))
    return finish(figure, save=save)


@styled
def indices(
    names: Sequence[str],
    groups: Sequence[tuple[str, np.ndarray, np.ndarray, np.ndarray, np.ndarray]],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw Sobol' indices as bars."""
    figure, axes = canvas(1, len(groups), height=2.5, sharey=True)
    index = np.arange(len(names))
    for axis, (label, first, total, first_error, total_error) in zip(axes[0], groups, strict=True):
        for shift, share, error, colour, word in (
            (-0.2, first, first_error, ACCENT, "first"),
            (0.2, total, total_error, MUTED, "total"),
        ):
            axis.bar(index + shift, share, 0.38, yerr=error, color=colour, label=word, error_kw={"lw": 0.8})
        axis.set_xticks(index, [pretty(n).replace(" ", "\n") for n in names], fontsize=7.5)
        axis.grid(False, axis="x")
        axis.set_title(label)
    axes[0, 0].set_ylabel("fraction of variance")
    axes[0, -1].legend(loc="upper left")
    return finish(figure, save=save)


def _some(count: int) -> Any:
    """Indices of the runs that the figure shows."""
    return np.arange(count)[:: max(1, -(-count // SHOWN))]
