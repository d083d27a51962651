"""A fraction of draws estimated with a surrogate and corrected by its errors at some model runs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def corrected_share(
    found: Float[np.ndarray, " draw"], checked: Float[np.ndarray, " check"], true: Float[np.ndarray, " check"]
) -> tuple[float, float]:
    """Correct a fraction estimated with a surrogate by its mean error at some model runs.

    ::

    p̂ = mean(I_s) + mean(I_t − I_s),    var p̂ = p (1 − p)/N + (q − d̄²)/m

    The first mean covers all N draws; the second mean, d̄, covers m draws. q is the fraction of these m draws for which surrogate
    and model disagree. The variance uses (k + ½)/(n + 1) instead of k/n for p and q: a count of zero in a finite sample does not
    prove a probability of zero.
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
