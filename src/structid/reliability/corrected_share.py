"""A fraction estimated by a surrogate, corrected by its errors in some model runs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def corrected_share(
    found: Float[np.ndarray, " draw"], checked: Float[np.ndarray, " check"], true: Float[np.ndarray, " check"]
) -> tuple[float, float]:
    """Correct a fraction by the difference observed in model runs.

    ::

    p̂ = mean(I_s) + mean(I_t − I_s),    var p̂ = p (1 − p)/N + (q − d̄²)/m

    The first mean is over all N draws, the second, d̄, over m of them; q is the fraction of those on which surrogate and model
    disagree. In the variance, p and q are (k + ½)/(n + 1) for k of n, since runs without a passage or a disagreement do not prove
    that there is none.
    """
    finite = found[np.isfinite(found)]
    if not len(finite):
        return float("nan"), float("nan")
    share = float(finite.mean())
    within = (finite.sum() + 0.5) / (len(finite) + 1.0)
    variance = within * (1.0 - within) / len(finite)
    difference = (true - checked)[np.isfinite(true - checked)]
    if len(checked):
        shift = float(difference.mean()) if len(difference) else 0.0
        disagree = (np.count_nonzero(difference) + 0.5) / (len(difference) + 1.0)
        share += shift
        variance += max(disagree - shift**2, 0.0) / max(len(difference), 1)
    return float(np.clip(share, 0.0, 1.0)), float(np.sqrt(variance))
