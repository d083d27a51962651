"""Figures of a posterior: marginals, pairs, traces, acceptance, identifiability."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from structid.core.units import label
from structid.figures.style import (
    ACCENT,
    CYCLE,
    MODEL,
    MUTED,
    PRIOR,
    canvas,
    density,
    finish,
    in_powers_of_ten,
    pretty,
    pretty_unit,
    shown,
    styled,
    thin,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_BARS = 400
"""Largest number of walkers with one bar per walker; for more walkers, a histogram of the acceptance rates is drawn."""
SLIVER = 0.01
"""Posterior width, as a fraction of the prior range, below which a line marks the posterior mean."""


def _label(name: str, unit: str) -> str:
    return label(pretty(name), pretty_unit(unit))


LONGEST_LABEL = 13
"""Characters per line of a label next to a small panel."""


def _label_in_lines(name: str, unit: str) -> str:
    """Label with the name above the unit; a long name is wrapped."""
    words, *rest = _label(name, unit).split(" [")
    if len(words) > LONGEST_LABEL:
        words = "\n".join(textwrap.wrap(words, LONGEST_LABEL))
    return "\n[".join([words, *rest])


def _scales(units: Sequence[str], draws: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """A power of ten for each parameter, and the parameter's unit with that power."""
    chosen = [in_powers_of_ten(unit, draws[:, i]) for i, unit in enumerate(units)]
    return np.array([c[0] for c in chosen]), [c[1] for c in chosen]


@styled
def marginals(
    names: Sequence[str],
    units: Sequence[str],
    prior: Float[np.ndarray, "draw parameter"],
    posterior: Float[np.ndarray, "posterior_draw parameter"],
    supports: Sequence[tuple[float, float]],
    best: Float[np.ndarray, " parameter"],
    truth: dict[str, float] | None = None,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot prior samples and posterior marginals."""
    truth = truth or {}
    figure, axes = canvas(len(names), 2, height=1.65, gridspec_kw={"width_ratios": [1.0, 1.25]})
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        one = _Marginal(prior[:, i], posterior[:, i], np.array(supports[i]), best[i], truth.get(name, np.nan))
        # The prior of a variance may be orders of magnitude wider than the posterior: each panel has its own unit.
        for axis, draw, draws in ((axes[i, 0], _prior_range, one.prior), (axes[i, 1], _posterior_range, one.posterior)):
            by, shown_unit = in_powers_of_ten(unit, draws)
            draw(axis, one.over(by))
            axis.set_xlabel(_label(name, shown_unit))
            axis.locator_params(axis="x", nbins=5)
    axes[0, 0].set_title("prior range: prior grey, posterior red", loc="left")
    axes[0, 1].set_title("posterior range", loc="left")
    axes[0, 1].legend(loc="upper left")
    return finish(figure, title, save)


class _Marginal(NamedTuple):
    """Prior, posterior, support, MAP and truth of one parameter in one unit; an unknown truth is NaN."""

    prior: np.ndarray
    posterior: np.ndarray
    support: np.ndarray
    best: float
    truth: float

    def over(self, by: float) -> _Marginal:
        """Data in another unit."""
        return _Marginal(self.prior / by, self.posterior / by, self.support / by, self.best / by, self.truth / by)


def _prior_range(axis: Axes, one: _Marginal) -> None:
    """Draw prior and posterior over the whole prior range; each density has its own scale."""
    p_low, p_high = np.quantile(one.prior, [0.001, 0.999])
    d_low, d_high = shown(one.posterior)
    span = np.linspace(min(p_low, d_low), max(p_high, d_high), 600)
    axis.hist(
        one.prior, bins=40, range=(span[0], span[-1]), color=MUTED, alpha=0.6, density=True, label="prior samples"
    )
    axis.plot(span, density(one.prior, span, *one.support), color=PRIOR, label="prior")
    twin = axis.twinx()
    twin.fill_between(span, density(one.posterior, span, *one.support), color=MODEL, alpha=0.7, lw=0)
    twin.set_ylim(bottom=0.0)
    if d_high - d_low < SLIVER * (span[-1] - span[0]):
        axis.axvline(one.posterior.mean(), color=MODEL, lw=1.8)
    for each in (axis, twin):
        each.set_yticks([])
        each.grid(False)
    if span[0] <= one.truth <= span[-1]:
        axis.axvline(one.truth, color="k", lw=0.8, ls=":")


def _posterior_range(axis: Axes, one: _Marginal) -> None:
    """Draw prior and posterior over the range of the posterior."""
    low, high = shown(one.posterior)
    margin = 0.25 * (high - low)
    near = np.linspace(max(low - margin, one.support[0]), min(high + margin, one.support[1]), 400)
    axis.fill_between(
        near, density(one.posterior, near, *one.support), color=MODEL, alpha=0.35, lw=0, label="posterior"
    )
    axis.plot(near, density(one.prior, near, *one.support), color=PRIOR, label="prior")
    axis.axvline(one.best, color=MODEL, lw=1.0, label="MAP")
    if near[0] <= one.truth <= near[-1]:
        axis.axvline(one.truth, color="k", lw=0.8, ls=":", label="truth")
    axis.set_yticks([])
    axis.set_ylim(bottom=0.0)


@styled
def pairs(
    names: Sequence[str],
    units: Sequence[str],
    draws: Float[np.ndarray, "draw parameter"],
    best: Float[np.ndarray, " parameter"],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw every pair of parameters: density below the diagonal, correlation above it."""
    count = len(names)
    scales, units = _scales(units, draws)
    draws, best = draws / scales, best / scales
    figure, axes = canvas(count, count, height=7.4 / count)
    correlation = np.atleast_2d(np.corrcoef(draws.T))
    limits = shown(draws)
    for i in range(count):
        for j in range(count):
            axis = axes[i, j]
            axis.grid(False)
            if j > i:
                _correlation_cell(axis, float(correlation[i, j]))
                continue
            if i == j:
                axis.hist(draws[:, i], bins=40, range=tuple(limits[:, i]), color=MODEL, alpha=0.6)
                axis.set_yticks([])
            else:
                # Rasterised in the PDF too: 1600 squares as paths take seconds to write, and viewers draw gaps between them.
                axis.hist2d(
                    draws[:, j],
                    draws[:, i],
                    bins=40,
                    range=[limits[:, j], limits[:, i]],
                    cmap="YlOrBr",
                    rasterized=True,
                )
                axis.plot(best[j], best[i], "+", color="k", ms=7)
                axis.set_ylim(*limits[:, i])
            axis.set_xlim(*limits[:, j])
            axis.ticklabel_format(useOffset=False)
            axis.locator_params(nbins=3)
            axis.tick_params(labelsize=6.5, labelleft=j == 0 and i > 0, labelbottom=i == count - 1)
            if i == count - 1:
                axis.tick_params(axis="x", rotation=30)
                axis.set_xlabel(_label_in_lines(names[j], units[j]), fontsize=7.5)
            if j == 0:
                axis.set_ylabel(_label_in_lines(names[i], units[i]), fontsize=7.5)
    return finish(figure, title, save)


def _correlation_cell(axis: Any, value: float) -> None:
    axis.text(
        0.5, 0.5, f"{value:+.2f}", ha="center", va="center", transform=axis.transAxes, alpha=0.35 + 0.65 * abs(value)
    )
    axis.set_xticks([])
    axis.set_yticks([])
    for spine in axis.spines.values():
        spine.set_visible(False)


@styled
def traces(
    names: Sequence[str],
    units: Sequence[str],
    history: Float[np.ndarray, "step ensemble walker parameter"],
    discarded: int,
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot walkers and ensemble means against the step."""
    scales, units = _scales(units, history.reshape(-1, len(names)))
    history = history / scales
    figure, axes = canvas(len(names), 1, height=1.35, sharex=True)
    steps = np.arange(len(history))[thin(len(history), 600)]
    for i, axis in enumerate(axes[:, 0]):
        for e in range(history.shape[1]):
            colour = CYCLE[e % len(CYCLE)]
            axis.plot(steps, history[steps, e, :: max(1, history.shape[2] // 6), i], color=colour, lw=0.25, alpha=0.35)
            axis.plot(steps, history[steps, e, :, i].mean(axis=1), color=colour, lw=1.1)
        axis.axvspan(0, discarded, color="#eeeeee", zorder=0, lw=0)
        kept = history[discarded:, :, :, i]
        low, high = shown(kept.ravel())
        axis.set_ylim(low - 0.6 * (high - low), high + 0.6 * (high - low))
        axis.set_ylabel(_label_in_lines(names[i], units[i]), fontsize=7.5)
    axes[0, 0].set_title("thin: walkers; thick: mean of each ensemble; grey: discarded", loc="left")
    axes[-1, 0].set_xlabel("step")
    axes[-1, 0].set_xlim(0, len(history))
    return finish(figure, title, save)


@styled
def acceptance(
    rates: Float[np.ndarray, "ensemble walker"], title: str = "", save: str | os.PathLike[str] | None = None
) -> Figure:
    """Draw the acceptance rate of each walker, or a histogram for a large number of walkers."""
    figure, axes = canvas(1, 1, height=1.9)
    draw = _histogram_of_rates if rates.size > MOST_BARS else _rate_of_each_walker
    draw(axes[0, 0], rates)
    return finish(figure, title, save)


def _rate_of_each_walker(axis: Axes, rates: np.ndarray) -> None:
    walkers = rates.shape[1]
    for e, row in enumerate(rates):
        edges = np.arange(walkers + 1) + e * walkers - 0.5
        axis.stairs(row, edges, fill=True, color=CYCLE[e % len(CYCLE)], label=f"ensemble {e + 1}")
    axis.axhline(np.median(rates), color="k", lw=0.8, ls=":")
    axis.set_ylim(0.0, max(1.15 * rates.max(), 0.05))
    axis.set_xlim(-0.5, rates.size - 0.5)
    axis.set_xlabel("walker")
    axis.set_ylabel("acceptance rate")
    if len(rates) <= 8:
        axis.legend(ncol=4, loc="upper right")


def _histogram_of_rates(axis: Axes, rates: np.ndarray) -> None:
    axis.hist(list(rates), bins=40, stacked=True, color=[CYCLE[e % len(CYCLE)] for e in range(len(rates))])
    axis.axvline(np.median(rates), color="k", lw=0.8, ls=":")
    axis.set_xlim(0.0, None)
    axis.set_xlabel("acceptance rate")
    axis.set_ylabel("walkers")


@styled
def identifiability(
    names: Sequence[str],
    eigenvalues: Float[np.ndarray, " combination"],
    eigenvectors: Float[np.ndarray, "parameter combination"],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot the information in the data about each combination of parameters."""
    figure, axes = canvas(1, 2, height=2.6)
    index = np.arange(len(eigenvalues))
    shown = np.maximum(eigenvalues, 1e-6)
    axes[0, 0].bar(index, shown, color=[ACCENT if v >= 1.0 else MODEL for v in eigenvalues])
    axes[0, 0].axhline(1.0, color="k", lw=0.8, ls=":")
    axes[0, 0].set_yscale("log")
    axes[0, 0].set_ylabel("information / prior")
    axes[0, 0].set_xticks(index, [str(i + 1) for i in index])
    axes[0, 0].set_xlabel("combination")
    axes[0, 0].set_title("below the dotted line, the prior dominates", loc="left")
    signs = np.sign(eigenvectors[np.argmax(np.abs(eigenvectors), axis=0), index])
    picture = axes[0, 1].imshow(eigenvectors * signs, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    axes[0, 1].grid(False)
    axes[0, 1].set_yticks(index, [pretty(n) for n in names])
    axes[0, 1].set_xticks(index, [str(i + 1) for i in index])
    axes[0, 1].set_xlabel("combination")
    figure.colorbar(picture, ax=axes[0, 1], label="weight [prior sd]")
    return finish(figure, title, save)
