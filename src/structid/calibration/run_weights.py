"""Weights of model runs by their closeness to the posterior, from a tempered posterior, π^τ."""

from __future__ import annotations

import numpy as np
import scipy
from jaxtyping import Float

from structid.inference.convergence import weighted_size

FITTED_SHARE = 0.5
"""Effective number of runs in the fit of a NARX, as a fraction of all runs; see `weighted_size`."""

LEAST = 1e-2
"""Smallest weight of a run; it prevents a false mode of the surrogate far from the posterior."""


def nearness(log_density: Float[np.ndarray, " run"]) -> Float[np.ndarray, " run"]:
    """Weight runs for the fit of a NARX, w = max(π^τ, `LEAST`), so that their effective number is half of all runs.

    A NARX with few terms cannot be exact over the whole prior. A NARX that errs only where the probability is negligible is
    better than a NARX that errs equally everywhere.
    """
    finite = np.isfinite(log_density)
    if not finite.any():
        return np.ones(len(log_density))
    farthest = log_density[finite].max() - log_density[finite].min()
    _, weights = tempered_weights(log_density, FITTED_SHARE, LEAST, -np.log(max(farthest, 1.0)) - 10.0)
    return weights


def tempered_weights(
    log_density: Float[np.ndarray, " run"], share: float, least: float = 0.0, lowest: float = -50.0
) -> tuple[float, Float[np.ndarray, " run"]]:
    """Weight runs, w = max(π^τ, `least`), with the largest τ ≤ 1 whose effective fraction of runs reaches `share`.

    The function returns τ and the weights; log τ is searched from `lowest` upwards.
    """
    finite = np.isfinite(log_density)
    below = np.where(finite, log_density - log_density[finite].max(), -np.inf)

    def weights(log_exponent: float) -> np.ndarray:
        return np.asarray(np.maximum(np.exp(np.exp(log_exponent) * below), least))

    def excess(log_exponent: float) -> float:
        return weighted_size(weights(log_exponent)) - share * len(below)

    if excess(0.0) >= 0.0:  # the runs are as good as draws of the posterior
        return 1.0, weights(0.0)
    result = float(scipy.optimize.brentq(excess, lowest, 0.0)) if excess(lowest) > 0.0 else lowest
    return float(np.exp(result)), weights(result)
