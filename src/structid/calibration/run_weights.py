"""Weights of model runs for a surrogate that must be accurate near the posterior."""

from __future__ import annotations

import numpy as np
import scipy
from jaxtyping import Float

from structid.inference.convergence import weighted_size

EFFECTIVE_SHARE = 0.5
"""Fraction of the runs that count effectively; see `weighted_size`."""

LEAST = 1e-2
"""Weight of a run far from the posterior, which keeps the surrogate from creating a false mode there."""


def nearness(log_density: Float[np.ndarray, " run"]) -> Float[np.ndarray, " run"]:
    """Weight runs by a tempered posterior, w = max(π^τ, `LEAST`), with the exponent τ for which half of the runs count.

    A NARX with few terms cannot be exact over the whole prior. One that errs only where there is no probability is better than
    one that errs equally everywhere.
    """
    finite = np.isfinite(log_density)
    if not finite.any():
        return np.ones(len(log_density))
    below = np.where(finite, log_density - log_density[finite].max(), -np.inf)

    def weights(log_exponent: float) -> np.ndarray:
        return np.asarray(np.maximum(np.exp(np.exp(log_exponent) * below), LEAST))

    def excess(log_exponent: float) -> float:
        return weighted_size(weights(log_exponent)) - EFFECTIVE_SHARE * len(below)

    if excess(0.0) >= 0.0:  # all runs are draws of the posterior, as it were
        return weights(0.0)
    lowest = -np.log(max(-below[finite].min(), 1.0)) - 10.0
    return weights(float(scipy.optimize.brentq(excess, lowest, 0.0))) if excess(lowest) > 0.0 else weights(lowest)
