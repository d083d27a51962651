"""Evidence for a parameter from draws of the posterior: the density ratio of Savage and Dickey.

If a law without a mechanism is the law with φ = φ₀, and the prior of φ does not depend on the other parameters, then

    Z/Z₀ = π(φ₀) / p(φ₀ | data)

J. M. Dickey (1971), doi 10.1214/aoms/1177693507. With u, the prior probability of smaller values, π(u₀) = 1.
"""

from __future__ import annotations

import numpy as np
import scipy.optimize
from jaxtyping import Float

from structid.probability.truncation import Marginal

SHARE = 0.1
"""Share of the draws, the nearest ones to φ₀, that determine the density there."""
STEEPEST = 3.0
"""Largest change of the log density over these draws; where it is larger, the draws do not reach φ₀."""
EDGE = 1e-12
"""Distance from the ends of the prior within which φ₀ lies at one of them."""
SMALL = 1e-4
"""Slope below which the density is straight."""


def log_evidence_by_draws(prior: Marginal, draws: Float[np.ndarray, " draw"], neutral: float) -> float | None:
    """Return log Z/Z₀ of a parameter with independent prior [nat]; None if the draws do not reach its neutral value."""
    at = float(prior.cdf(np.array([neutral]))[0])
    if min(at, 1.0 - at) < EDGE and not _is_end(prior, round(at), neutral):
        return None
    log_density = _log_density_at(at, prior.cdf(draws))
    return None if log_density is None else -log_density


def _is_end(prior: Marginal, end: int, neutral: float) -> bool:
    """Whether a value is an end of the prior, or the limit of a prior without an end."""
    value = float(prior.quantile(np.array([float(end)]))[0])
    return not np.isfinite(value) or bool(np.isclose(value, neutral, rtol=1e-9, atol=1e-12))


def _log_density_at(at: float, u: Float[np.ndarray, " draw"]) -> float | None:
    """Return the log density of values in [0, 1] at a point, from an exponential density that is fitted to the nearest values."""
    distance = np.abs(u - at)
    width = float(np.quantile(distance, SHARE))
    low, high = max(at - width, 0.0), min(at + width, 1.0)
    near = u[distance <= width]
    if width <= 0.0 or len(near) == len(u):
        return None
    # p(u) ∝ e^(k t), t = (u − low)/(high − low); the mean of t determines k.
    slope = _slope_of_mean(float(np.mean((near - low) / (high - low))))
    if slope is None:
        return None
    place = (at - low) / (high - low)
    return float(np.log(len(near) / len(u) / (high - low)) + slope * place - _log_integral(slope))


def _log_integral(slope: float) -> float:
    """Return log ∫₀¹ e^(kt) dt."""
    return float(np.log(np.expm1(slope) / slope)) if abs(slope) > SMALL else 0.5 * slope


def _slope_of_mean(mean: float) -> float | None:
    """Return k of the density e^(kt) on [0, 1] with the mean 1/(1 − e^(−k)) − 1/k; None if it is too steep."""

    def excess(slope: float) -> float:
        of_slope = -1.0 / np.expm1(-slope) - 1.0 / slope if abs(slope) > SMALL else 0.5 + slope / 12.0
        return float(of_slope - mean)

    if not excess(-STEEPEST) < 0.0 < excess(STEEPEST):
        return None
    return float(scipy.optimize.brentq(excess, -STEEPEST, STEEPEST))
