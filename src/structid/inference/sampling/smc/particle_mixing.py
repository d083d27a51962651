"""Whether particles that were moved a few times have reached equilibrium."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.probability.ranks import ranks

MOVED_BY = 5.0
"""Largest change of a mean that counts as equilibrium, in standard errors, when dozens of quantities are tested."""


def still_moving(
    draws: Float[np.ndarray, "step population particle quantity"],
    log_density: Float[np.ndarray, "step population particle"] | None = None,
) -> dict[int, float]:
    """Quantities whose mean changes from the first half of the moves to the second.

    Every particle is compared with itself, so that a common drift much smaller than the spread is detected. Ranks are compared,
    so that outliers do not dominate. The log density, if given, is the last quantity.
    """
    half = len(draws) // 2
    if half == 0:
        return {}
    moving = {}
    for index, quantity in enumerate([*np.moveaxis(draws, -1, 0), *([] if log_density is None else [log_density])]):
        places = ranks(quantity)
        change = places[-half:].mean(axis=0) - places[:half].mean(axis=0)
        # Copies of a particle depend on each other; populations are independent.
        variance = max(
            change.var() / change.size, change.mean(axis=1).var(ddof=1) / len(change) if len(change) > 1 else 0.0
        )
        if variance > 0.0 and abs(change.mean()) > MOVED_BY * np.sqrt(variance):
            moving[index] = float(change.mean() / np.sqrt(variance))
    return moving
