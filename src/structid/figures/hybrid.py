"""Figures of hybrid tests: specimen, structure, actuators, predictions."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from structid.figures.style import (
    ACCENT,
    CYCLE,
    MEASURED,
    MODEL,
    MUTED,
    canvas,
    density,
    finish,
    name_axes,
    pretty,
    pretty_unit,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Curve = tuple[str, np.ndarray, np.ndarray]
"""Name, abscissae and ordinates."""


@styled
def loops_of_tests(
    curves: Sequence[Curve],
    names: tuple[str, str],
    units: tuple[str, str],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw force against displacement, one panel per test with common scales; earlier tests are grey."""
    columns = min(3, len(curves))
    rows = -(-len(curves) // columns)
    figure, axes = canvas(rows, columns, height=2.3, sharex=True, sharey=True)
    for k, axis in enumerate(axes.ravel()):
        if k >= len(curves):
            axis.set_visible(False)
            continue
        for _, x, y in curves[:k]:
            axis.plot(x, y, color=MUTED, lw=0.4)
        axis.plot(curves[k][1], curves[k][2], color=MEASURED, lw=0.8)
        axis.set_title(f"test {curves[k][0]}", loc="left")
        axis.tick_params(labelbottom=k + columns >= len(curves))
        if k + columns >= len(curves):
            axis.set_xlabel(f"{names[0]} [{pretty_unit(units[0])}]")
        if k % columns == 0:
            axis.set_ylabel(f"{names[1]} [{pretty_unit(units[1])}]")
    return finish(figure, title, save)


@styled
def histories_of_tests(
    curves: Sequence[Sequence[Curve]],
    tests: Sequence[str],
    unit: str,
    ends: Sequence[float | None],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot displacements against simulated time, one panel per test."""
    figure, axes = canvas(len(tests), 1, height=1.35, sharex=True)
    for axis, lines, test, end in zip(axes[:, 0], curves, tests, ends, strict=True):
        for (name, time, values), colour in zip(lines, CYCLE, strict=False):
            axis.plot(time, values, color=colour, lw=0.8, label=name)
        if end is not None:
            axis.axvline(end, color=MODEL, lw=1.0, ls="--")
        axis.set_title(f"test {test}", loc="left")
        axis.set_ylabel(f"u [{pretty_unit(unit)}]")
    axes[0, 0].legend(loc="upper right", ncol=3)
    axes[-1, 0].set_xlabel("simulated time [s]")
    return finish(figure, title, save)


@styled
def tracking(
    plane: Curve,
    time: Float[np.ndarray, " move"],
    indicator: Float[np.ndarray, " move"],
    energy: Float[np.ndarray, " move"],
    unit: str,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the tracking of an actuator: synchronisation subspace plot, tracking indicator, energy error."""
    figure, axes = canvas(1, 3, height=2.4)
    _tracking_panels(axes[0], plane, time, indicator, energy, unit)
    return finish(figure, title, save)


@styled
def loop_and_tracking(
    loop: Curve,
    plane: Curve,
    time: np.ndarray,
    indicator: np.ndarray,
    energy: np.ndarray,
    units: tuple[str, str],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the hysteresis loop of a specimen, and the tracking of its actuator."""
    figure, axes = canvas(2, 2, height=2.4)
    first, *others = axes.ravel()
    first.plot(loop[1], loop[2], color=MEASURED, lw=0.8)
    name_axes(first, (pretty(loop[0]), units[0]), ("force", units[1]))
    _tracking_panels(others, plane, time, indicator, energy, units[0])
    return finish(figure, title, save)


def _tracking_panels(
    axes: Sequence[Axes], plane: Curve, time: np.ndarray, indicator: np.ndarray, energy: np.ndarray, unit: str
) -> None:
    left, middle, right = axes
    left.plot(plane[1], plane[2], color=MEASURED, lw=0.6)
    span = [float(np.min(plane[1])), float(np.max(plane[1]))]
    left.plot(span, span, color=MUTED, lw=0.8, ls="--")
    name_axes(left, ("target", unit), ("measured", unit))
    middle.plot(time, indicator, color=ACCENT, lw=0.8)
    name_axes(middle, ("simulated time", "s"), ("tracking indicator", f"{pretty_unit(unit)}²"))
    right.plot(time, energy, color=ACCENT, lw=0.8)
    name_axes(right, ("simulated time", "s"), ("energy error", "J"))


@styled
def predicted_test(
    time: Float[np.ndarray, " time"],
    band: tuple[np.ndarray, np.ndarray],
    observed: Curve,
    peaks: Float[np.ndarray, " draw"],
    peak: float,
    unit: str,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the prediction of a later test, and the observed response."""
    figure, axes = canvas(1, 2, height=2.6, gridspec_kw={"width_ratios": [2.2, 1.0]})
    left, right = axes[0]
    left.plot(observed[1], observed[2], color=MEASURED, lw=0.9, label="observed")
    left.fill_between(time, *band, color=MODEL, alpha=0.45, lw=0, label="predicted, 5–95 %", zorder=3)
    low, high = left.get_ylim()
    left.set_ylim(low, high + 0.25 * (high - low))
    left.legend(loc="upper right", ncol=2)
    name_axes(left, ("simulated time", "s"), (observed[0], unit))
    reach = np.concatenate([peaks, [peak]])
    margin = 0.15 * np.ptp(reach)
    points = np.linspace(reach.min() - margin, reach.max() + margin, 400)
    right.fill_between(points, density(peaks, points, -np.inf, np.inf), color=MODEL, alpha=0.4, lw=0)
    right.axvline(peak, color=MEASURED, lw=1.2)
    right.set_yticks([])
    right.set_xlabel(f"largest {pretty(observed[0])} [{pretty_unit(unit)}]")
    right.set_ylim(bottom=0.0)
    right.ticklabel_format(axis="x", useOffset=False)
    right.xaxis.set_major_locator(_few_ticks())
    return finish(figure, title, save)


@styled
def filtered_path(
    names: Sequence[str],
    units: Sequence[str],
    starts: Sequence[tuple[str, int]],
    path: tuple[np.ndarray, np.ndarray, np.ndarray],
    posterior: dict[str, tuple[float, float]],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot the estimates of a filter against the number of the move, with the posterior intervals."""
    columns = 2 if len(names) > 1 else 1
    rows = -(-len(names) // columns)
    figure, axes = canvas(rows, columns, height=1.7, sharex=True)
    moves = np.arange(len(path[0]))
    for k, axis in enumerate(axes.ravel()):
        if k >= len(names):
            axis.set_visible(False)
            continue
        axis.fill_between(moves, path[1][:, k], path[2][:, k], color=ACCENT, alpha=0.3, lw=0)
        axis.plot(moves, path[0][:, k], color=ACCENT, lw=0.9, label="filter, 95 %")
        if names[k] in posterior:
            axis.axhspan(*posterior[names[k]], color=MODEL, alpha=0.6, lw=0.8, label="posterior, 95 %")
        for name, first in starts:
            axis.axvline(first, color=MUTED, lw=0.6)
            if k < columns:
                axis.text(first, 1.02, f" {name}", transform=axis.get_xaxis_transform(), fontsize=7, color="#5c646d")
        late = path[0][len(moves) // 20 :, k], path[1][len(moves) // 20 :, k], path[2][len(moves) // 20 :, k]
        shown = np.concatenate([*late, posterior.get(names[k], ())])
        low, high = shown.min(), shown.max()
        margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0  # a constant estimate has no range
        axis.set_ylim(low - margin, high + margin)
        axis.set_ylabel(f"{pretty(names[k])} [{pretty_unit(units[k])}]" if units[k] else pretty(names[k]))
        if k + columns >= len(names):
            axis.set_xlabel("move")
    axes[0, 0].legend(loc="best")
    return finish(figure, title, save)


def _few_ticks() -> object:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(3)
