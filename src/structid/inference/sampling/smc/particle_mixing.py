"""Whether particles that were moved a few times have reached equilibrium."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.probability.ranks import ranks

DENSEST = 0.9, 0.99
"""Quantiles of the log density above which the share of the draws is observed: the share in a narrow spike may still grow."""
MOVED_BY = 5.0
"""Largest change of a mean that counts as equilibrium, in standard errors, when dozens of quantities are tested."""


def still_moving(
    draws: Float[np.ndarray, "step population particle quantity"],
    log_density: Float[np.ndarray, "step population particle"] | None = None,
) -> dict[int, float]:
    """Quantities whose mean changes from the first half of the moves to the second.

    Every particle is compared with itself, so that a common drift much smaller than the spread is detected. Ranks are compared,
    so that outliers do not dominate. The log density, if given, comes after the quantities, and then the shares of the draws above
    high quantiles of it.
    """
    half = len(draws) // 2
    if half == 0:
        return {}
    moving = {}
    quantities = [ranks(quantity) for quantity in np.moveaxis(draws, -1, 0)]
    if log_density is not None:
        quantities += [ranks(log_density), *shares_of_densest(log_density)]
    for index, places in enumerate(quantities):
        change = places[-half:].mean(axis=0) - places[:half].mean(axis=0)
        # Copies of a particle depend on each other; populations are independent.
        variance = max(
            change.var() / change.size, change.mean(axis=1).var(ddof=1) / len(change) if len(change) > 1 else 0.0
        )
        if variance > 0.0 and abs(change.mean()) > MOVED_BY * np.sqrt(variance):
            moving[index] = float(change.mean() / np.sqrt(variance))
    return moving


def shares_of_densest(
    log_density: Float[np.ndarray, "step population particle"],
) -> Float[np.ndarray, "quantile step population particle"]:
    """Return one where the log density is above a high quantile of all draws, and zero elsewhere."""
    return np.stack([(log_density > edge).astype(np.float64) for edge in np.quantile(log_density, DENSEST)])
