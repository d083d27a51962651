"""Figures of designs: points in a parameter space."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from structid.core.units import label
from structid.figures.style import ACCENT, MODEL, canvas, finish, pretty, pretty_unit, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def samples(
    names: Sequence[str],
    units: Sequence[str],
    points: Float[np.ndarray, "point parameter"],
    places: Float[np.ndarray, "place parameter"],
    densities: Float[np.ndarray, "place parameter"],
    title: str = "",
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Plot samples from a prior: a histogram with the density for each parameter, and a scatter plot for each pair."""
    count = len(names)
    figure, axes = canvas(count, count, height=min(7.4 / count, 3.0))
    texts = [label(pretty(name), pretty_unit(unit)) for name, unit in zip(names, units, strict=True)]
    for i in range(count):
        for j in range(count):
            axis = axes[i, j]
            if j > i:
                axis.set_axis_off()
                continue
            if i == j:
                axis.hist(points[:, i], bins=30, density=True, color=ACCENT, alpha=0.6)
                axis.plot(places[:, i], densities[:, i], color=MODEL, lw=1.0)
                axis.set_yticks([])
            else:
                axis.plot(points[:, j], points[:, i], ".", color=ACCENT, ms=1.5, alpha=0.5, rasterized=True)
            axis.locator_params(nbins=4)
            axis.tick_params(labelleft=j == 0 and i > 0, labelbottom=i == count - 1)
            if i == count - 1:
                axis.set_xlabel(texts[j])
            if j == 0 and i > 0:
                axis.set_ylabel(texts[i])
    return finish(figure, title, save)
