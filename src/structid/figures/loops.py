"""Figures of hysteresis loops: measured and modelled loops, loops identified by several methods, lines fitted to a loop."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from structid.figures.style import CYCLE, MEASURED, MODEL, MUTED, canvas, finish, name_axes, pretty, pretty_unit, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def loops(
    measured: tuple[np.ndarray, np.ndarray] | None,
    model: tuple[np.ndarray, np.ndarray],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
    names: tuple[str, str] = ("measured", "identified"),
    draws: Sequence[tuple[np.ndarray, np.ndarray]] = (),
) -> Figure:
    """Draw hysteresis loops: measured, model, and one over the other.

    Parameters
    ----------
    measured, model : pair of ndarray, shape (time,)
        Displacement [mm] and force [kN]; None if no loop was measured.
    title : str
        Title.
    save : path-like, optional
        File name without extension; a PNG and a PDF are written.
    names : pair of str
        Titles of the two.
    draws : sequence of pairs of ndarray
        Loops of further draws, drawn thin behind the model's loop.

    Returns
    -------
    Figure
        Three panels, or one without a measurement.
    """
    panels = 3 if measured is not None else 1
    figure, axes = canvas(1, panels, height=2.7, width=7.4 if panels > 1 else 4.2, sharex=True, sharey=True)
    for axis in axes[0, (1 if measured is not None else 0) :]:
        for u, f in draws:
            axis.plot(u, f, color=MODEL, lw=0.3, alpha=0.12)
    if measured is not None:
        for axis in (axes[0, 0], axes[0, 2]):
            axis.plot(*measured, color=MEASURED, lw=0.7)
        axes[0, 0].set_title(names[0])
        axes[0, 2].set_title("superposed")
        axes[0, 1].set_title(names[1])
    for axis in axes[0, 1:] if measured is not None else axes[0]:
        axis.plot(*model, color=MODEL, lw=0.7)
    for axis in axes[0]:
        axis.set_xlabel("displacement [mm]")
    axes[0, 0].set_ylabel("restoring force [kN]")
    return finish(figure, title, save)


@styled
def identified(
    time: np.ndarray,
    measured: np.ndarray,
    predictions: dict[str, np.ndarray],
    measured_loop: tuple[np.ndarray, np.ndarray] | None,
    loops_of: dict[str, tuple[np.ndarray, np.ndarray]],
    name: str,
    unit: str,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a deterministic calibration: measured loop, identified loops, both superposed, and the histories around the peak.

    Parameters
    ----------
    time : ndarray, shape (time,)
        Times [s].
    measured : ndarray, shape (time,)
        The measured channel.
    predictions : dict of str to ndarray, shape (time,)
        The identified histories, by method.
    measured_loop : pair of ndarray, shape (time,), optional
        Displacement [mm] and force [kN], if known.
    loops_of : dict of str to pair of ndarray, shape (time,)
        Identified loops, by method.
    name, unit : str
        Name and unit of the channel.
    title : str
        Title.
    save : path-like, optional
        File name without extension; a PNG and a PDF are written.

    Returns
    -------
    Figure
        Four panels, or two if no loop is known.
    """
    figure, axes = canvas(*((1, 2) if measured_loop is None else (2, 2)), height=2.6)
    panels = axes.ravel()
    heads: tuple[str, ...] = ("identified", "histories around the peak")
    if measured_loop is not None:
        heads = ("measured", "identified", "superposed", "histories around the peak")
        for axis in panels[[0, 2]]:
            axis.plot(*measured_loop, color=MEASURED, lw=0.7)
    for axis in panels[:1] if measured_loop is None else panels[1:3]:
        _identified_loops(axis, loops_of)
    panel_history = panels[-1]
    panel_history.plot(time, measured, color=MEASURED, lw=1.0, label="measured")
    for (method, values), colour in zip(predictions.items(), CYCLE, strict=False):
        panel_history.plot(time, values, color=colour, lw=0.8, ls="--", label=method.replace("_", " "))
    peak = time[int(np.argmax(np.abs(measured)))]
    panel_history.set_xlim(max(peak - 2.0, time[0]), min(peak + 2.0, time[-1]))
    low, high = panel_history.get_ylim()
    panel_history.set_ylim(low, high + 0.35 * (high - low))  # room for the legend
    panel_history.legend(loc="upper right", ncol=3, columnspacing=0.8, handlelength=1.2, fontsize=7)
    panels[0 if measured_loop is None else 1].legend(loc="upper left")
    for axis, head in zip(panels, heads, strict=True):
        axis.set_title(head, loc="left")
    for axis in panels[:-1]:
        name_axes(axis, ("displacement", "mm"), ("restoring force", "kN"))
        if axis is not panels[0]:
            axis.sharex(panels[0])
            axis.sharey(panels[0])
    name_axes(panel_history, ("time", "s"), (pretty(name), pretty_unit(unit)))
    return finish(figure, title, save)


def _identified_loops(axis: Axes, loops_of: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    for i, ((method, loop), colour) in enumerate(zip(loops_of.items(), CYCLE, strict=False)):
        # The first loop is thicker, so that all methods are visible where they agree.
        axis.plot(*loop, color=colour, lw=1.6 if i == 0 and len(loops_of) > 1 else 0.6, label=method.replace("_", " "))


@styled
def two_lines(
    displacement: np.ndarray,
    force: np.ndarray,
    lines: Sequence[tuple[np.ndarray, np.ndarray, str]],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a loop and the straight lines fitted to it.

    Parameters
    ----------
    displacement, force : ndarray, shape (time,)
        The loop [mm], [kN].
    lines : sequence of (ndarray, ndarray, str)
        Displacements [mm], forces [kN] and label of each line.
    title : str
        Title.
    save : path-like, optional
        File name without extension; a PNG and a PDF are written.

    Returns
    -------
    Figure
        One panel.
    """
    figure, axes = canvas(1, 1, height=3.2, width=4.8)
    axis = axes[0, 0]
    axis.plot(displacement, force, color=MUTED, lw=0.6)
    seen: dict[str, str] = {}
    for x, y, text in lines:
        colour = seen.setdefault(text, CYCLE[(len(seen) + 1) % len(CYCLE)])
        axis.plot(x, y, color=colour, lw=1.6, label=text)
    handles, labels = axis.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axis.legend(list(unique.values()), list(unique), loc="lower right")
    margin = 0.1 * np.ptp(force)
    axis.set_ylim(force.min() - margin, force.max() + margin)
    name_axes(axis, ("displacement", "mm"), ("restoring force", "kN"))
    return finish(figure, title, save)
