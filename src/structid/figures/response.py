"""Figures of response histories: measurements, predictions with bands, energies, whiteness of the residuals."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy
from jaxtyping import Float

from structid.figures.style import (
    ACCENT,
    MEASURED,
    MODEL,
    MUTED,
    canvas,
    finish,
    in_lines,
    name_axes,
    plain_ticks,
    pretty,
    pretty_unit,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def histories(
    time: Float[np.ndarray, " time"],
    columns: Sequence[np.ndarray],
    names: Sequence[str],
    units: Sequence[str],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw histories, one below another."""
    figure, axes = canvas(len(columns), 1, height=1.7, sharex=True)
    for axis, values, name, unit in zip(axes[:, 0], columns, names, units, strict=True):
        axis.plot(time, values, color=ACCENT, lw=0.8)
        axis.set_ylabel(in_lines(f"{pretty(name)} [{pretty_unit(unit)}]" if unit else pretty(name)))
        axis.set_xlim(time[0], time[-1])
    axes[-1, 0].set_xlabel("time [s]")
    return finish(figure, title, save)


@styled
def measurement_on_record(
    time: Float[np.ndarray, " time"],
    excitation: tuple[np.ndarray, str, str],
    measured: Sequence[tuple[np.ndarray, str, str]],
    modelled: Sequence[np.ndarray] | None = None,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
    measured_time: Float[np.ndarray, " sample"] | None = None,
) -> Figure:
    """Draw the excitation above the measurement, so that a time shift is visible before sampling starts.

    Stretches of the record without measured values are grey. `measured_time` are the times of the measurement, if they are not
    those of the record.
    """
    rows = [excitation, *measured]
    of_sensor = time if measured_time is None else measured_time
    figure, axes = canvas(len(rows), 2, height=1.7, sharex="col", width_ratios=(2, 1))
    strong = np.cumsum((excitation[0] ** 2).reshape(len(time), -1).sum(axis=1))
    middle = time[int(np.searchsorted(strong, 0.05 * strong[-1]))]
    span = 0.1 * (time[-1] - time[0])
    for row, (values, name, unit) in enumerate(rows):
        for axis in axes[row]:
            axis.plot(of_sensor if row else time, values, color=MEASURED if row else MUTED, lw=0.9, label="measured")
            if row and modelled is not None:
                axis.plot(of_sensor, modelled[row - 1], color=MODEL, lw=0.8, label="model at the prior medians")
            for begin, end in _unmeasured(of_sensor, values, time) if row else ():
                axis.axvspan(begin, end, color=MUTED, alpha=0.2, lw=0)
        axes[row, 0].set_ylabel(in_lines(f"{pretty(name)} [{pretty_unit(unit)}]" if unit else pretty(name)))
        axes[row, 0].set_xlim(time[0], time[-1])
        axes[row, 1].set_xlim(max(time[0], middle - span), min(time[-1], middle + span))
    if modelled is not None:
        axes[1, 0].legend(loc="upper right", ncol=2)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    return finish(figure, title, save)


@styled
def sensor_coverage(
    record: tuple[str, float, float],
    sensors: Sequence[tuple[str, Sequence[tuple[float, float]], Sequence[tuple[float, float]]]],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a record and its sensors as bars on one time axis.

    `record` has a name, a begin and an end; a sensor has a name, the stretches with measured values, and those left out.
    """
    figure, axes = canvas(1, 1, height=0.7 + 0.28 * (len(sensors) + 1))
    axis, (name, begin, end) = axes[0, 0], record
    axis.broken_barh([(begin, end - begin)], (-0.3, 0.6), color=MUTED)
    for row, (_, measured, left_out) in enumerate(sensors, start=1):
        for stretches, colour, label in ((measured, ACCENT, "used"), (left_out, MEASURED, "left out")):
            widths = [(first, last - first) for first, last in stretches]
            axis.broken_barh(
                widths, (row - 0.3, 0.6), color=colour, alpha=1.0 if colour == ACCENT else 0.35, label=label
            )
    axis.set_yticks(range(len(sensors) + 1), [name, *(pretty(sensor) for sensor, _, _ in sensors)])
    axis.invert_yaxis()
    axis.set_xlabel("time on the record's time base [s]")
    handles, labels = axis.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    figure.legend(once.values(), once.keys(), loc="outside lower center", ncol=2)
    return finish(figure, save=save)


def _unmeasured(times: np.ndarray, values: np.ndarray, time: np.ndarray) -> list[tuple[float, float]]:
    """Stretches of a record without measured values, longer than two samples."""
    measured = times[np.isfinite(values)]
    ends = np.concatenate([[time[0]], measured, [time[-1]]])
    step = max(times[1] - times[0], time[1] - time[0])
    return [(float(ends[i]), float(ends[i + 1])) for i in np.flatnonzero(np.diff(ends) > 2.0 * step)]


@styled
def four_panels(
    time: Float[np.ndarray, " time"],
    displacement: Float[np.ndarray, " time"],
    velocity: Float[np.ndarray, " time"],
    force: Float[np.ndarray, " time"],
    hysteretic_energy: Float[np.ndarray, " time"],
    elastic_energy: Float[np.ndarray, " time"],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw displacement, velocity, the restoring-force loop and the absorbed energy."""
    figure, axes = canvas(2, 2, height=2.5)
    axes[0, 0].plot(time, displacement, color=ACCENT, lw=0.8)
    name_axes(axes[0, 0], ("time", "s"), ("displacement", "mm"))
    axes[0, 1].plot(time, velocity, color=ACCENT, lw=0.8)
    name_axes(axes[0, 1], ("time", "s"), ("velocity", "mm/s"))
    axes[1, 0].plot(displacement, force, color=ACCENT, lw=0.6)
    name_axes(axes[1, 0], ("displacement", "mm"), ("restoring force", "kN"))
    axes[1, 1].plot(time, hysteretic_energy + elastic_energy, color=MEASURED, label="total")
    axes[1, 1].plot(time, hysteretic_energy, color=MODEL, label="hysteretic")
    axes[1, 1].plot(time, elastic_energy, color=ACCENT, lw=0.7, label="elastic")
    axes[1, 1].legend(loc="best")
    name_axes(axes[1, 1], ("time", "s"), ("absorbed energy", "J"))
    return finish(figure, title, save)


@styled
def bands(
    time: Float[np.ndarray, " time"],
    measured: Float[np.ndarray, " time"] | None,
    best: Float[np.ndarray, " time"],
    inner: tuple[np.ndarray, np.ndarray],
    outer: tuple[np.ndarray, np.ndarray] | None,
    name: str,
    unit: str,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
    reference: str = "measured",
) -> Figure:
    """Draw a measured history and its prediction bands: the whole history, the time around the peak, and the residual.

    For a good fit, the bands are thinner than a line in the first panel but readable in the last panel.
    """
    figure, axes = canvas(3, 1, height=2.0)
    peak = time[int(np.nanargmax(np.abs(best if measured is None else measured)))]
    half = min(0.06 * time[-1], 2.0)
    whole, close = (time[0], time[-1]), (max(peak - half, 0.0), min(peak + half, time[-1]))
    for axis, span, base in zip(axes[:, 0], (whole, close, whole), (0.0, 0.0, best), strict=True):
        if outer is not None:
            _band(axis, time, (outer[0] - base, outer[1] - base), 0.18, "90 % with discrepancy")
        _band(axis, time, (inner[0] - base, inner[1] - base), 0.55, "90 % of the model's response")
        if measured is not None:
            axis.plot(time, measured - base, color=MEASURED, lw=0.8 if axis is not axes[2, 0] else 0.4, label=reference)
        # Dashed on top of the measurement: the two lines coincide in a good fit.
        axis.plot(time, best - base, color=MODEL, lw=0.9, ls="-" if measured is None else (0, (4, 3)), label="MAP")
        axis.set_xlim(*span)
        name_axes(axis, ("time", "s"), (pretty(name), pretty_unit(unit)))
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncol=4)
    axes[1, 0].set_title("around the peak", loc="left")
    axes[2, 0].set_title("residual with respect to the MAP prediction", loc="left")
    return finish(figure, title, save)


def _band(axis: Axes, time: np.ndarray, edges: tuple[np.ndarray, np.ndarray], strength: float, what: str) -> None:
    axis.fill_between(time, *edges, color=MODEL, alpha=strength, lw=0, label=what)


@styled
def energy(
    time: Float[np.ndarray, " time"],
    measured: Float[np.ndarray, " time"] | None,
    best: Float[np.ndarray, " time"],
    band: tuple[np.ndarray, np.ndarray],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the energy absorbed by the spring."""
    figure, axes = canvas(1, 1, height=2.6)
    axis = axes[0, 0]
    axis.fill_between(time, *band, color=MODEL, alpha=0.35, lw=0, label="90 % of the model's response")
    axis.plot(time, best, color=MODEL, label="MAP")
    if measured is not None:
        axis.plot(time, measured, color=MEASURED, label="truth of the virtual experiment")
    axis.set_xlim(time[0], time[-1])
    axis.legend(loc="lower right")
    name_axes(axis, ("time", "s"), ("absorbed energy", "J"))
    return finish(figure, title, save)


@styled
def side_by_side(
    time: Float[np.ndarray, " time"],
    measured: Float[np.ndarray, " time"] | None,
    inner: Sequence[tuple[np.ndarray, np.ndarray]],
    outer: Sequence[tuple[np.ndarray, np.ndarray]],
    classes: Sequence[str],
    name: str,
    unit: str,
    reference: str = "measured",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw predictions of one measured history by several model classes, around the peak and relative to the band middle."""
    figure, axes = canvas(len(classes), 2, height=1.9, sharex="col", sharey="col")
    strongest = np.abs(outer[0]).max(axis=0) if measured is None else np.abs(measured)
    peak = time[int(np.nanargmax(strongest))]
    half = min(0.1 * time[-1], 4.0)
    for (close, left), one, response, shown in zip(axes, classes, inner, outer, strict=True):
        middle = 0.5 * (response[0] + response[1])
        for axis, base in ((close, 0.0), (left, middle)):
            _band(axis, time, (shown[0] - base, shown[1] - base), 0.2, "90 % with discrepancy")
            _band(axis, time, (response[0] - base, response[1] - base), 0.6, "90 % of the model's response")
            if measured is not None:
                axis.plot(time, measured - base, color=MEASURED, lw=0.9 if axis is close else 0.4, label=reference)
            last = close is axes[-1, 0]
            name_axes(axis, ("time", "s") if last else ("", ""), (pretty(name), pretty_unit(unit)))
        close.set_xlim(max(peak - half, time[0]), min(peak + half, time[-1]))
        left.set_xlim(time[0], time[-1])
        close.set_title(one, loc="left")
        left.set_title("difference from the middle of the band", loc="left")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncol=3)
    return finish(figure, save=save)


@styled
def residuals(
    lags: Float[np.ndarray, " lag"],
    autocorrelation: Float[np.ndarray, " lag"],
    bound: float,
    frequency: Float[np.ndarray, " frequency"],
    spectrum: Float[np.ndarray, " frequency"],
    values: Float[np.ndarray, " time"],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw three checks of the whiteness of whitened residuals: autocorrelation, spectrum, quantiles."""
    figure, axes = canvas(1, 3, height=2.4)
    left, middle, right = axes[0]
    left.axhspan(-bound, bound, color=MUTED, alpha=0.3, lw=0)
    left.plot(lags, autocorrelation, color=ACCENT, lw=0.9)
    left.set_ylim(-1.05, 1.05)
    left.set_title("autocorrelation", loc="left")
    name_axes(left, ("lag", "s"), ("", ""))
    middle.axhline(1.0, color=MUTED, lw=1.2)
    middle.loglog(frequency, spectrum, color=ACCENT, lw=0.9)
    plain_ticks(middle.xaxis)
    plain_ticks(middle.yaxis)
    middle.set_title("power relative to white noise", loc="left")
    name_axes(middle, ("frequency", "Hz"), ("", ""))
    ordered = np.sort(values)
    quantiles = scipy.stats.norm.ppf((np.arange(len(ordered)) + 0.5) / len(ordered))
    ends = np.array([quantiles[0], quantiles[-1]])
    right.plot(ends, ends, color=MUTED, lw=1.2)
    right.plot(quantiles, ordered, ".", ms=2.5, color=ACCENT, rasterized=True)
    right.set_title("quantiles", loc="left")
    name_axes(right, ("unit normal", ""), ("residual", ""))
    return finish(figure, save=save)
