"""Figures of hysteresis loops: measured loops, model loops, loops identified by several methods, fitted lines."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from structid.figures.cycles import chosen_cycles
from structid.figures.style import CYCLE, MEASURED, MUTED, canvas, finish, name_axes, pretty, pretty_unit, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Loop = tuple[np.ndarray, np.ndarray]
"""Displacement [mm] and force [kN]."""


@styled
def loops(
    time: Float[np.ndarray, " time"],
    measured: Loop | None,
    model: Loop,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
    names: tuple[str, str] = ("measured", "identified"),
    draws: Sequence[Loop] = (),
) -> Figure:
    """Draw hysteresis loops: all cycles in thin grey lines, and a few cycles from early to late in colour."""
    together = [(names[1], model)] if measured is None else [(names[0], measured), (names[1], model)]
    shown = chosen_cycles(together[0][1][0])
    colours = _from_early_to_late(len(shown))
    figure, axes = canvas(
        1, 1 if measured is None else 3, height=2.9, width=4.2 if measured is None else 7.4, sharex=True, sharey=True
    )
    for axis, (name, loop) in zip(axes[0], together, strict=False):
        axis.plot(*loop, color=MUTED, lw=0.35)
        if loop is model:
            _cycles_of_draws(axis, draws, shown, colours)
        for cycle, colour in zip(shown, colours, strict=True):
            axis.plot(*_part(loop, cycle), color=colour, lw=1.2, label=f"from {time[cycle.start]:.1f} s")
        axis.set_title(name, loc="left")
    if measured is not None:
        for cycle, colour in zip(shown, colours, strict=True):
            axes[0, 2].plot(*_part(measured, cycle), color=MEASURED, lw=1.3)
            axes[0, 2].plot(*_part(model, cycle), color=colour, lw=1.0, ls=(0, (3, 1.5)))
        axes[0, 2].set_title("coloured cycles of both", loc="left")
    for axis in axes[0]:
        axis.set_xlabel("displacement [mm]")
    axes[0, 0].set_ylabel("restoring force [kN]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncol=2 if measured is None else len(labels) or 1)
    return finish(figure, title, save)


def _part(loop: Loop, cycle: slice) -> Loop:
    return loop[0][cycle], loop[1][cycle]


def _cycles_of_draws(axis: Axes, draws: Sequence[Loop], shown: Sequence[slice], colours: Sequence[str]) -> None:
    for loop in draws:
        for cycle, colour in zip(shown, colours, strict=True):
            axis.plot(*_part(loop, cycle), color=colour, lw=0.3, alpha=0.25)


def _from_early_to_late(count: int) -> list[str]:
    """Colours from dark (early) to light (late)."""
    import matplotlib

    shades = matplotlib.colormaps["plasma"](np.linspace(0.05, 0.8, count)) if count else ()
    return [matplotlib.colors.to_hex(shade) for shade in shades]


@styled
def identified(
    time: Float[np.ndarray, " time"],
    measured: Float[np.ndarray, " time"],
    predictions: dict[str, np.ndarray],
    true_loop: Loop | None,
    loops_of: dict[str, Loop],
    name: str,
    unit: str,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the largest cycle of the loops that a deterministic calibration identified, and the histories around the peak."""
    figure, axes = canvas(1, 2, height=2.9, width_ratios=(2, 3))
    loop_panel, history = axes[0]
    largest = chosen_cycles(next(iter(loops_of.values()))[0] if true_loop is None else true_loop[0], most=1)
    cycle = largest[0] if largest else slice(None)
    if true_loop is not None:
        loop_panel.plot(*_part(true_loop, cycle), color=MUTED, lw=2.6, label="truth of the virtual experiment")
    history.plot(time, measured, color=MEASURED, lw=1.0, label="measured")
    for (method, loop), colour in zip(loops_of.items(), CYCLE, strict=False):
        label = method.replace("_", " ")
        loop_panel.plot(*_part(loop, cycle), color=colour, lw=1.0, ls="--", label=label)
        history.plot(time, predictions[method], color=colour, lw=0.8, ls="--")
    peak = time[int(np.nanargmax(np.abs(measured)))]
    history.set_xlim(max(peak - 2.0, time[0]), min(peak + 2.0, time[-1]))
    loop_panel.set_title(f"the largest cycle, from {time[cycle.start or 0]:.1f} s", loc="left")
    history.set_title("around the peak", loc="left")
    name_axes(loop_panel, ("displacement", "mm"), ("restoring force", "kN"))
    name_axes(history, ("time", "s"), (pretty(name), pretty_unit(unit)))
    handles = [*loop_panel.get_legend_handles_labels()[0], *history.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower center", ncol=len(handles))
    return finish(figure, title, save)


@styled
def loop_and_lines(
    displacement: Float[np.ndarray, " time"],
    force: Float[np.ndarray, " time"],
    lines: Sequence[tuple[np.ndarray, np.ndarray, str]],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a loop and the straight lines fitted to it."""
    figure, axes = canvas(1, 1, height=3.2, width=4.8)
    axis = axes[0, 0]
    axis.plot(displacement, force, color=MUTED, lw=0.6)
    legend: dict[str, str] = {}
    for x, y, text in lines:
        colour = legend.setdefault(text, CYCLE[(len(legend) + 1) % len(CYCLE)])
        axis.plot(x, y, color=colour, lw=1.6, label=text)
    handles, labels = axis.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axis.legend(list(unique.values()), list(unique), loc="lower right")
    margin = 0.1 * np.ptp(force)
    axis.set_ylim(force.min() - margin, force.max() + margin)
    name_axes(axis, ("displacement", "mm"), ("restoring force", "kN"))
    return finish(figure, title, save)
