"""Figure of a fragility curve: probabilities against the strength of the ground motion, with their uncertainty."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from structid.figures.style import ACCENT, MODEL, MUTED, canvas, finish, name_axes, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def curve(
    levels: Float[np.ndarray, " level"],
    of_each: Float[np.ndarray, "record level"],
    probability: Float[np.ndarray, " level"],
    error: Float[np.ndarray, " level"],
    band: tuple[np.ndarray, np.ndarray],
    fitted: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    words: str,
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw a fragility curve."""
    figure, axes = canvas(1, 1, height=2.9)
    axis = axes[0, 0]
    for number, row in enumerate(of_each):
        label = f"{len(of_each)} single records" if number == 0 and len(of_each) > 1 else None
        axis.plot(levels, row, color=MUTED, lw=0.7, label=label)
    axis.fill_between(levels, *band, color=ACCENT, alpha=0.2, lw=0, label="90 % of the posterior draws")
    label = "mean ± 2 standard errors"
    axis.errorbar(levels, probability, 2.0 * error, fmt="o", ms=4, color=MODEL, lw=1.0, label=label)
    at, middle, low, high = fitted
    if np.isfinite(middle).all():
        axis.plot(at, middle, color=MODEL, lw=1.2, label=words)
    if np.isfinite(low).all():
        axis.fill_between(at, low, high, color=MODEL, alpha=0.12, lw=0, label="90 % for other records")
    axis.set_ylim(-0.03, 1.03)
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    name_axes(axis, ("peak ground acceleration", "m/s²"), ("P(passage or failure | data)", ""))
    return finish(figure, save=save)
