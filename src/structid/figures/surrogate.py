"""Figures of a surrogate: its validation and its coefficients."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from structid.figures.style import ACCENT, MEASURED, MODEL, MUTED, WIDTH, finish, name_axes, pretty, pretty_unit, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def validation(
    time: Float[np.ndarray, " time"],
    true: Float[np.ndarray, "3 time"],
    predicted: Float[np.ndarray, "3 time"],
    shown_errors: Float[np.ndarray, " 3"],
    peaks: Float[np.ndarray, " run"],
    predicted_peaks: Float[np.ndarray, " run"],
    samples: Float[np.ndarray, " sample"],
    predicted_samples: Float[np.ndarray, " sample"],
    errors: Float[np.ndarray, " run"],
    channel: str,
    unit: str,
    integrated: tuple[np.ndarray, np.ndarray] | None = None,
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the histories with the smallest, median and largest error; peaks; samples; and the distribution of the errors."""
    from matplotlib.figure import Figure

    histories = 3 if integrated is None else 4
    figure = Figure(figsize=(WIDTH, 4.0 + 1.2 * histories), layout="constrained")
    grid = figure.add_gridspec(histories + 1, 3, height_ratios=(*(1.0,) * histories, 1.9))
    first = None
    for row, name in enumerate(("best", "median", "worst")):
        axis = figure.add_subplot(grid[row, :], sharex=first)
        first = first or axis
        axis.plot(time, true[row], color=MEASURED, lw=1.1, label="model")
        axis.plot(time, predicted[row], color=MODEL, lw=0.9, ls=(0, (4, 2)), label="surrogate")
        axis.set_title(f"{name}: ε = {shown_errors[row]:.1e}", loc="left")
        name_axes(axis, ("time", "s") if row == histories - 1 else ("", ""), (pretty(channel), pretty_unit(unit)))
        axis.tick_params(labelbottom=row == histories - 1)
    assert first is not None
    if integrated is not None:
        axis = figure.add_subplot(grid[3, :], sharex=first)
        axis.plot(time, integrated[0], color=MEASURED, lw=1.1)
        axis.plot(time, integrated[1], color=MODEL, lw=0.9, ls=(0, (4, 2)))
        axis.set_title("worst, integrated", loc="left")
        name_axes(axis, ("time", "s"), ("displacement", "mm"))
    first.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=2)
    unit = pretty_unit(unit)
    _scatter(figure.add_subplot(grid[histories, 0]), peaks, predicted_peaks, f"peak |{pretty(channel)}|", unit)
    _scatter(figure.add_subplot(grid[histories, 1]), samples, predicted_samples, pretty(channel), unit)
    _distribution(figure.add_subplot(grid[histories, 2]), errors)
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
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=2)
    diverged = int(np.count_nonzero(~np.isfinite(errors)))
    name_axes(axis, ("relative error ε", ""), ("runs", ""))
    if diverged:
        axis.set_xlabel(f"relative error ε ({diverged} diverged, not drawn)")


@styled
def coefficients(
    own: Float[np.ndarray, "run coefficient"],
    predicted: Float[np.ndarray, "run coefficient"],
    names: tuple[str, ...],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot the coefficients predicted by a surrogate against the coefficients fitted to each run."""
    from matplotlib.figure import Figure

    columns = 4
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(WIDTH, 1.75 * rows), layout="constrained")
    for index, name in enumerate(names):
        axis = figure.add_subplot(rows, columns, index + 1)
        low, high = float(own[:, index].min()), float(own[:, index].max())
        axis.plot([low, high], [low, high], color=MUTED, lw=0.8)
        axis.scatter(own[:, index], predicted[:, index], s=3.0, color=ACCENT, alpha=0.5, lw=0, rasterized=True)
        axis.set_title(name, fontsize=7.5, loc="left")
        axis.tick_params(labelsize=6.5)
        axis.locator_params(nbins=3)
    figure.supxlabel("coefficients fitted to the run", fontsize=9)
    figure.supylabel("coefficients predicted from the parameters", fontsize=9)
    return finish(figure, save=save)
