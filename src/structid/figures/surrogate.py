"""Figures of a surrogate: how it stood its validation, and its coefficients."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from structid.figures.style import ACCENT, MEASURED, MODEL, MUTED, WIDTH, finish, name_axes, pretty, pretty_unit, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def validation(
    time: np.ndarray,
    true: np.ndarray,
    predicted: np.ndarray,
    shown_errors: np.ndarray,
    peaks: np.ndarray,
    predicted_peaks: np.ndarray,
    samples: np.ndarray,
    predicted_samples: np.ndarray,
    errors: np.ndarray,
    channel: str,
    unit: str,
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw best, median and worst history, peaks, samples, and the distribution of the errors.

    Parameters
    ----------
    time : ndarray, shape (time,)
        [s].
    true, predicted : ndarray, shape (3, time)
        Histories of the best, the median and the worst run.
    shown_errors : ndarray, shape (3,)
        Their errors.
    peaks, predicted_peaks : ndarray, shape (run,)
        Largest absolute values.
    samples, predicted_samples : ndarray, shape (sample,)
        A thin selection of all samples.
    errors : ndarray, shape (run,)
        Relative errors of all runs; infinite where the surrogate diverged.
    channel, unit : str
        What is drawn.
    save : path-like, optional
        File name without ending.

    Returns
    -------
    Figure
        Three rows of histories above three panels.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 7.6), layout="constrained")
    grid = figure.add_gridspec(4, 3, height_ratios=(1.0, 1.0, 1.0, 1.9))
    first = None
    for row, name in enumerate(("best", "median", "worst")):
        axis = figure.add_subplot(grid[row, :], sharex=first)
        first = first or axis
        axis.plot(time, true[row], color=MEASURED, lw=1.1, label="model")
        axis.plot(time, predicted[row], color=MODEL, lw=0.9, ls=(0, (4, 2)), label="surrogate")
        axis.set_title(f"{name}: ε = {shown_errors[row]:.1e}", loc="left")
        name_axes(axis, ("", "") if row < 2 else ("time", "s"), (pretty(channel), pretty_unit(unit)))
        axis.tick_params(labelbottom=row == 2)
    assert first is not None
    first.legend(loc="upper right", ncols=2)
    unit = pretty_unit(unit)
    _scatter(figure.add_subplot(grid[3, 0]), peaks, predicted_peaks, f"peak |{pretty(channel)}|", unit)
    _scatter(figure.add_subplot(grid[3, 1]), samples, predicted_samples, pretty(channel), unit)
    _distribution(figure.add_subplot(grid[3, 2]), errors)
    return finish(figure, save=save)


def _scatter(axis: Axes, true: np.ndarray, predicted: np.ndarray, what: str, unit: str) -> None:
    low, high = float(true.min()), float(true.max())
    margin = 0.04 * (high - low) or 1.0
    axis.plot([low - margin, high + margin], [low - margin, high + margin], color=MUTED, lw=0.8, zorder=1)
    axis.scatter(true, predicted, s=3.0, color=ACCENT, alpha=0.35, lw=0, zorder=2, rasterized=True)
    axis.set_xlim(low - margin, high + margin)
    axis.set_ylim(low - margin, high + margin)
    axis.set_aspect("equal")
    name_axes(axis, (f"model: {what}", unit), ("surrogate", unit))


def _distribution(axis: Axes, errors: np.ndarray) -> None:
    finite = errors[np.isfinite(errors) & (errors > 0)]
    if len(finite):
        low, high = np.floor(np.log10(finite.min())), np.ceil(np.log10(finite.max()))
        axis.hist(finite, bins=list(np.logspace(low, max(high, low + 1), 40)), color=ACCENT, alpha=0.75)
        axis.axvline(finite.mean(), color=MODEL, lw=1.2, label="mean")
        axis.axvline(np.median(finite), color=MEASURED, lw=1.0, ls=":", label="median")
        axis.set_xscale("log")
        axis.legend(loc="upper right")
    diverged = int(np.count_nonzero(~np.isfinite(errors)))
    name_axes(axis, ("relative error ε", ""), ("runs", ""))
    if diverged:
        axis.set_title(f"{diverged} diverged, not drawn", loc="left")


@styled
def coefficients(
    trained: np.ndarray,
    predicted: dict[str, np.ndarray],
    names: tuple[str, ...],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw coefficients that interpolations predict against those they were fitted to.

    Parameters
    ----------
    trained : ndarray, shape (run, coefficient)
        Coefficients of the experiments.
    predicted : dict of str to ndarray, shape (run, coefficient)
        What each interpolation says there.
    names : tuple of str
        What the coefficients belong to.
    save : path-like, optional
        File name without ending.

    Returns
    -------
    Figure
        A panel a coefficient.
    """
    from matplotlib.figure import Figure

    columns = 5
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(WIDTH, 1.7 * rows), layout="constrained")
    for place, name in enumerate(names):
        axis = figure.add_subplot(rows, columns, place + 1)
        low, high = float(trained[:, place].min()), float(trained[:, place].max())
        axis.plot([low, high], [low, high], color=MUTED, lw=0.8)
        for (label, values), colour in zip(predicted.items(), (ACCENT, MODEL), strict=False):
            axis.scatter(trained[:, place], values[:, place], s=2.5, color=colour, alpha=0.4, lw=0, label=label)
        axis.set_title(name, fontsize=7.5, loc="left")
        axis.tick_params(labelsize=6.5)
        if place == 0 and len(predicted) > 1:
            axis.legend(fontsize=6.5, markerscale=3)
    return finish(figure, save=save)
