"""Figures of calibrations: log weights in the rounds of a sequential calibration, ranks in simulation-based calibration."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy
from jaxtyping import Float, Int

from structid.figures.style import ACCENT, MODEL, MUTED, WIDTH, canvas, finish, pretty, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LARGEST_SHOWN = 30.0
"""Log weights of larger magnitude are drawn as triangles at this limit [nat]."""
USUALLY_SHOWN = 0.3
"""Smallest axis limit for log ratios [nat]; the limit is three times the 80 % quantile of their magnitude if that is larger."""


@styled
def rounds(
    training: Sequence[int],
    log_weights: Sequence[np.ndarray],
    spread: float,
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot the log weights of each round's new draws, relative to their median."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    axis = figure.add_subplot()
    axis.axhspan(-spread, spread, color=MUTED, alpha=0.18, lw=0)
    axis.axhline(0.0, color=MUTED, lw=0.8)
    for column, weights in enumerate(log_weights):
        finite = np.isfinite(weights)
        middle = np.median(weights[finite]) if finite.any() else 0.0
        places = np.where(finite, weights - middle, -np.inf)
        # Golden-ratio jitter keeps neighbouring points apart.
        across = column + 0.5 * ((np.arange(len(weights)) * 0.618) % 1.0 - 0.5)
        shown = np.clip(places, -LARGEST_SHOWN, LARGEST_SHOWN)
        beyond = np.abs(places) > LARGEST_SHOWN
        last = column == len(log_weights) - 1
        axis.plot(across[~beyond], shown[~beyond], "o", ms=3, mew=0, alpha=0.7, color=ACCENT if last else MODEL)
        axis.plot(across[beyond], shown[beyond], "v", ms=4, mew=0, color=ACCENT if last else MODEL)
    if any(np.abs(axis.get_ylim()) > 1.0):  # below 1, a symmetric log axis has no tick except 0
        axis.set_yscale("symlog", linthresh=1.0)
    axis.set_xlim(-0.5, len(training) - 0.5)
    axis.set_xticks(range(len(training)), [f"round {i + 1}\n{n} runs" for i, n in enumerate(training)])
    axis.set_ylabel(r"log $\pi_\mathrm{true}/\pi_\mathrm{surrogate}$ [nat]")
    return finish(figure, save=save)


@styled
def ranks(
    names: Sequence[str],
    counts: Int[np.ndarray, "parameter bin"],
    replicas: int,
    half: Float[np.ndarray, " parameter"],
    most: Float[np.ndarray, " parameter"],
    places: Float[np.ndarray, "replica parameter"],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw histograms of the ranks of the true values among posterior draws, and the difference from uniform ranks."""
    bins = counts.shape[1]
    low, high = scipy.stats.binom.ppf([0.005, 0.995], replicas, 1.0 / bins)
    largest = scipy.stats.kstwo.ppf(0.99, replicas)  # Kolmogorov and Smirnov
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure, axes = canvas(2 * rows, columns, height=1.6, sharey="row")
    uppers, lowers = axes[0::2].ravel(), axes[1::2].ravel()
    for axis in (*uppers[len(names) :], *lowers[len(names) :]):
        axis.set_visible(False)
    edges, across = np.linspace(0.0, 1.0, bins + 1), np.linspace(0.0, 1.0, 1001)
    for upper, lower, name, count, a, b, ranks_of_name in zip(
        uppers, lowers, names, counts, half, most, places.T, strict=False
    ):
        upper.axhspan(low, high, color=MUTED, alpha=0.3, lw=0)
        upper.axhline(replicas / bins, color=MUTED, lw=0.8)
        outside = (count < low) | (count > high)
        upper.bar(edges[:-1], count, width=0.94 / bins, align="edge", color=list(np.where(outside, MODEL, ACCENT)))
        upper.set_title(pretty(name))
        away = np.searchsorted(np.sort(ranks_of_name), across, side="right") / replicas - across
        lower.axhspan(-largest, largest, color=MUTED, alpha=0.3, lw=0)
        lower.plot(across, away, lw=1.0, color=MODEL if np.abs(away).max() > largest else ACCENT)
        lower.set_xlabel(f"rank of the true value\ncoverage of 50 %: {a:.0%}, of 90 %: {b:.0%}")
        for axis in (upper, lower):
            axis.set_xlim(0.0, 1.0)
            axis.set_xticks([0.0, 0.5, 1.0], ["0", "0.5", "1"])
    for upper, lower in zip(axes[0::2, 0], axes[1::2, 0], strict=True):
        upper.set_ylabel("replicas")
        lower.set_ylabel("ECDF − uniform")
    return finish(figure, save=save)


def ratios_over_parameters(
    draws: Float[np.ndarray, "draw parameter"],
    log_ratios: Float[np.ndarray, " draw"],
    names: Sequence[str],
    spread: float,
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot the log ratio of the model density to the density of the draws, against each parameter."""
    from matplotlib.figure import Figure

    across = min(len(names), 3)
    down = -(-len(names) // across)
    figure = Figure(figsize=(WIDTH, 0.6 + 2.1 * down), layout="constrained")
    ran = np.isfinite(log_ratios)
    above = log_ratios[ran] - np.median(log_ratios[ran])
    edge = max(USUALLY_SHOWN, 3.0 * float(np.quantile(np.abs(above), 0.8))) if ran.any() else USUALLY_SHOWN
    beyond = np.abs(above) > edge
    for index, (name, values) in enumerate(zip(names, draws.T, strict=True)):
        axis = figure.add_subplot(down, across, index + 1)
        axis.axhspan(-spread, spread, color=MUTED, alpha=0.18, lw=0)
        axis.axhline(0.0, color=MUTED, lw=0.8)
        axis.plot(values[ran][~beyond], above[~beyond], "o", ms=3.5, mew=0, alpha=0.8, color=ACCENT)
        for marker, some in (("^", beyond & (above > 0.0)), ("v", beyond & (above < 0.0))):
            axis.plot(values[ran][some], np.clip(above[some], -edge, edge), marker, ms=4.5, mew=0, color=ACCENT)
        axis.set_ylim(-1.15 * edge, 1.15 * edge)
        axis.locator_params(axis="x", nbins=3)
        for failed in values[~ran]:
            axis.axvline(failed, color=MODEL, lw=0.8, ls=":")
        axis.set_xlabel(name)
        if index % across == 0:
            axis.set_ylabel(r"log $\pi/q$ [nat]")
    return finish(figure, save=save)
