"""A share that a surrogate gives, corrected by what it gets wrong among some true runs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def corrected_share(
    found: Float[np.ndarray, " draw"], checked: Float[np.ndarray, " check"], true: Float[np.ndarray, " check"]
) -> tuple[float, float]:
    """Correct a share by a difference that true runs tell.

    ::

        p̂ = mean(I_s) + mean(I_t − I_s),    var p̂ = p (1 − p)/N + (q − d̄²)/m

    The first mean is over all N draws, the second, d̄, over m of them. q is the share of those on which surrogate and model
    disagree. In the variance p and q are (k + ½)/(n + 1) of k among n: runs without a passage, or without a disagreement, do not
    tell that there is none.
    """
    known = found[np.isfinite(found)]
    if not len(known):
        return float("nan"), float("nan")
    share = float(known.mean())
    within = (known.sum() + 0.5) / (len(known) + 1.0)
    variance = within * (1.0 - within) / len(known)
    difference = (true - checked)[np.isfinite(true - checked)]
    if len(checked):
        shift = float(difference.mean()) if len(difference) else 0.0
        disagree = (np.count_nonzero(difference) + 0.5) / (len(difference) + 1.0)
        share += shift
        variance += max(disagree - shift**2, 0.0) / max(len(difference), 1)
    return float(np.clip(share, 0.0, 1.0)), float(np.sqrt(variance))
