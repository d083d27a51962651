"""Whether particles that were drawn once and moved a few times have come to rest."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.probability.ranks import ranks

MOVED_BY = 5.0
"""Standard errors by which the mean of a quantity at rest may change: the largest of some dozens."""


def still_moving(draws: Float[np.ndarray, "step population particle quantity"]) -> dict[int, float]:
    """Quantities whose mean changes from the first half of the moves to the second.

    Every particle is compared with itself, so that a common drift much smaller than the spread of the particles is seen. Ranks are
    compared, so that far particles do not decide.
    """
    half = len(draws) // 2
    if half == 0:
        return {}
    moving = {}
    for place in range(draws.shape[-1]):
        places = ranks(draws[..., place])
        change = places[-half:].mean(axis=0) - places[:half].mean(axis=0)
        # Copies of a particle are not independent of each other; populations are.
        variance = max(
            change.var() / change.size, change.mean(axis=1).var(ddof=1) / len(change) if len(change) > 1 else 0.0
        )
        if variance > 0.0 and abs(change.mean()) > MOVED_BY * np.sqrt(variance):
            moving[place] = float(change.mean() / np.sqrt(variance))
    return moving
