"""Figures of cyclic tests: loops of test and law, measures of the cycles, predicted forces."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from structid.figures.style import ACCENT, MEASURED, MODEL, MUTED, canvas, finish, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = ("displacement [mm]", "force [kN]")


class CycleCurves(NamedTuple):
    """Measures of the cycles of a test."""

    displacement: Float[np.ndarray, "cycle 2"]  # at the ends of the cycles [mm]
    force: Float[np.ndarray, "cycle 2"]  # at these displacements [kN]
    energy: Float[np.ndarray, " cycle"]  # [kJ]
    stiffness: Float[np.ndarray, " cycle"]  # [kN/mm]
    damping: Float[np.ndarray, " cycle"]  # [%]


@styled
def loops_of_law(
    displacement: Float[np.ndarray, " time"],
    measured: Float[np.ndarray, " time"],
    model: Float[np.ndarray, " time"],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the loops of the test, of the law, and the force that the law does not explain."""
    figure, axes = canvas(1, 3, height=2.7, sharex=True, sharey=True)
    for axis, force, colour, name in zip(
        axes[0],
        (measured, model, measured - model),
        (MEASURED, MODEL, ACCENT),
        ("test", "law", "difference"),
        strict=True,
    ):
        axis.plot(displacement, force, color=colour, lw=0.6)
        axis.set_title(name, loc="left")
        axis.set_xlabel(NAMES[0])
    axes[0, 0].set_ylabel(NAMES[1])
    return finish(figure, title, save)


@styled
def missing_terms(
    displacement: Float[np.ndarray, " time"],
    cumulative: Float[np.ndarray, " time"],
    residual: Float[np.ndarray, " time"],
    terms: Float[np.ndarray, " time"],
    start: int,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the force that a law leaves, and its missing terms: over the displacement, and along the test."""
    figure, axes = canvas(1, 2, height=2.6, sharey=True)
    over, along = axes[0]
    for axis, x, name in ((over, displacement, NAMES[0]), (along, cumulative, "cumulative displacement [m]")):
        axis.plot(x, residual, color=MUTED, lw=0.6, label="left by the law")
        axis.plot(x, terms, color=ACCENT, lw=0.7, label="missing terms")
        axis.set_xlabel(name)
    if start < len(cumulative):
        along.axvline(cumulative[start], color=MEASURED, lw=0.7, ls="--")
    over.set_ylabel(NAMES[1])
    over.legend(loc="upper left")
    return finish(figure, title, save)


@styled
def measures_of_cycles(
    measured: CycleCurves,
    model: CycleCurves,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw energy, envelope, secant stiffness and equivalent damping of every cycle, of the test and of the law."""
    figure, axes = canvas(2, 2, height=2.3)
    energy, envelope, stiffness, damping = axes.ravel()
    number = np.arange(1, len(measured.energy) + 1)
    amplitude = 0.5 * np.diff(measured.displacement, axis=1)[:, 0]
    for cycles, colour, marker, name in ((measured, MEASURED, "o", "test"), (model, MODEL, "x", "law")):
        style = {"color": colour, "marker": marker, "ms": 3.5, "lw": 0.7}
        energy.plot(number, np.cumsum(cycles.energy), label=name, **style)
        order = np.argsort(cycles.displacement.ravel())
        ends = cycles.displacement.ravel()[order], cycles.force.ravel()[order]
        envelope.plot(*ends, **{**style, "lw": 0.0})
        stiffness.plot(amplitude, cycles.stiffness, **{**style, "lw": 0.0})
        damping.plot(amplitude, cycles.damping, **{**style, "lw": 0.0})
    for axis, x, y in (
        (energy, "cycle", "dissipated energy [kJ]"),
        (envelope, *NAMES),
        (stiffness, "amplitude [mm]", "stiffness [kN/mm]"),
        (damping, "amplitude [mm]", "damping ratio [%]"),
    ):
        axis.set_xlabel(x)
        axis.set_ylabel(y)
    stiffness.set_ylim(bottom=0.0)
    damping.set_ylim(bottom=0.0)
    handles, labels = energy.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncol=2)
    return finish(figure, title, save)


@styled
def predicted_force(
    displacement: Float[np.ndarray, " time"],
    measured: Float[np.ndarray, " time"] | None,
    mean: Float[np.ndarray, " time"],
    band: tuple[Float[np.ndarray, " time"], Float[np.ndarray, " time"]],
    start: int,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the predicted force along the samples with its band, and its loops; the data of the fit are grey."""
    figure, axes = canvas(1, 2, height=2.7, width_ratios=(3, 2))
    history, loops = axes[0]
    samples, part = np.arange(len(mean)), slice(start, None)
    history.fill_between(samples[part], band[0][part], band[1][part], color=MODEL, alpha=0.25, lw=0, label="90 % band")
    history.plot(samples[part], mean[part], color=MODEL, lw=0.8, label="prediction")
    if measured is not None:
        history.plot(samples[:start], measured[:start], color=MUTED, lw=0.7, label="data of the fit")
        history.plot(samples[part], measured[part], color=MEASURED, lw=0.7, label="measured")
        loops.plot(displacement[part], measured[part], color=MEASURED, lw=0.6)
    loops.plot(displacement[part], mean[part], color=MODEL, lw=0.6)
    history.set_xlabel("sample")
    history.set_ylabel(NAMES[1])
    loops.set_xlabel(NAMES[0])
    handles, labels = history.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncol=len(handles))
    return finish(figure, title, save)


@styled
def response_band(
    time: Float[np.ndarray, " time"],
    low: Float[np.ndarray, " time"],
    high: Float[np.ndarray, " time"],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the band of a displacement history."""
    figure, axes = canvas(1, 1, height=2.2)
    axes[0, 0].fill_between(time, low, high, color=MODEL, alpha=0.6, lw=0.3)
    axes[0, 0].set_xlabel("time [s]")
    axes[0, 0].set_ylabel(NAMES[0])
    return finish(figure, title, save)
