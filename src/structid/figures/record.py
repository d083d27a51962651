"""Figures of a record: ground acceleration, Fourier amplitude, response spectrum, filter tuning."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from structid.figures.style import ACCENT, MODEL, canvas, finish, name_axes, styled, wide_top

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def record(
    time: Float[np.ndarray, " time"],
    acceleration: Float[np.ndarray, " time"],
    frequency: Float[np.ndarray, " frequency"],
    amplitude: Float[np.ndarray, " frequency"],
    period: Float[np.ndarray, " period"],
    pseudo_acceleration: Float[np.ndarray, " period"],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a record, its Fourier amplitude and its response spectrum."""
    figure, top, (left, right_panel) = wide_top(height=2.3)
    top.plot(time, acceleration, color=ACCENT, lw=0.7)
    peak = int(np.argmax(np.abs(acceleration)))
    top.plot(time[peak], acceleration[peak], "o", color=MODEL, ms=4)
    # The label is on the side of the peak with more space.
    right = time[peak] < 0.6 * time[-1]
    top.annotate(
        f"PGA {abs(acceleration[peak]):.3g} m/s²",
        (time[peak], acceleration[peak]),
        xytext=(8 if right else -8, 0),
        textcoords="offset points",
        color=MODEL,
        ha="left" if right else "right",
        va="center",
    )
    top.set_xlim(0.0, time[-1])
    name_axes(top, ("time", "s"), ("ground acceleration", "m/s²"))
    shown = frequency > 0
    left.loglog(frequency[shown], amplitude[shown], color=ACCENT, lw=0.7)
    _log_limits(left, frequency[shown], amplitude[shown])
    name_axes(left, ("frequency", "Hz"), ("Fourier amplitude", "m/s"))
    right_panel.semilogx(period, pseudo_acceleration, color=ACCENT)
    right_panel.set_ylim(bottom=0.0)
    right_panel.set_title("response spectrum, ζ = 5 %", loc="left")
    name_axes(right_panel, ("period", "s"), ("pseudo-acceleration", "m/s²"))
    return finish(figure, title, save)


@styled
def filter_tuning(
    time: Float[np.ndarray, " time"],
    raw: Float[np.ndarray, " time"],
    raw_frequency: Float[np.ndarray, " frequency"],
    raw_amplitude: Float[np.ndarray, " frequency"],
    filtered_time: Float[np.ndarray, " time"],
    filtered: Float[np.ndarray, " time"],
    filtered_frequency: Float[np.ndarray, " frequency"],
    filtered_amplitude: Float[np.ndarray, " frequency"],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a record before and after filtering, in the time and frequency domains."""
    figure, axes = canvas(3, 1, height=1.9)
    peak = time[int(np.argmax(np.abs(raw)))]
    for axis, span in ((axes[0, 0], (time[0], time[-1])), (axes[1, 0], (max(peak - 1.0, 0.0), peak + 1.0))):
        axis.plot(time, raw, color=ACCENT, lw=1.0, label="before")
        # Dashed: "before" stays visible where the filter changes little.
        axis.plot(filtered_time, filtered, color=MODEL, lw=1.0, ls=(0, (3, 2)), label="after")
        axis.set_xlim(*span)
        name_axes(axis, ("time", "s"), ("acceleration", "m/s²"))
    axes[0, 0].legend(ncol=2, loc="upper right")
    low = axes[2, 0]
    low.loglog(raw_frequency[1:], raw_amplitude[1:], color=ACCENT, lw=1.4)
    low.loglog(filtered_frequency[1:], np.maximum(filtered_amplitude[1:], 1e-300), color=MODEL, lw=0.6)
    _log_limits(low, raw_frequency[1:], raw_amplitude[1:])
    name_axes(low, ("frequency", "Hz"), ("Fourier amplitude", "m/s"))
    return finish(figure, title, save)


def _log_limits(axis: Axes, frequency: np.ndarray, amplitude: np.ndarray) -> None:
    """Show five decades below the peak; smaller values are rounding errors."""
    axis.set_ylim(amplitude.max() * 1e-5, amplitude.max() * 2.0)
    axis.set_xlim(max(frequency[0], 0.05), frequency[-1])
