"""Variation of importance weights: their coefficient of variation χ, and an upper bound on it from a small sample.

Let π be the true posterior, q the drawn density and w = π/q, scaled so that E_q w = 1. Then χ = sd_q(w). For every function f of
the parameters, E_π f − E_q f = E_q[(w − 1) (f − E_q f)], so that by the Cauchy-Schwarz inequality

    |E_π f − E_q f| ≤ χ sd_q(f).

One number bounds the shift of every mean (f = x), of every probability (f = 1 in the event: χ √(p (1 − p))) and, by f = (x − μ)²,
of every standard deviation. χ² is the chi-squared divergence of π from q (Liese & Vajda 2006, IEEE Trans. Inf. Theory 52(10)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from structid.inference.convergence import weighted_size

KURTOSIS = 6.0
"""Smallest kurtosis of the weights that the bound assumes: twice that of a normal distribution, since a surrogate errs most in
the tails. If the draws have a larger kurtosis, the bound uses it."""

NOISE = 0.02
"""Standard deviation of noise that is formally added to the weights and subtracted from the bound. The variance of
nearly constant weights with one outlier is poorly determined; the noise makes the estimate more reliable."""

LEAST_QUANTILE = 1e-12
"""Smallest usable quantile; below it, a few weights outweigh all others and the bound is infinite."""


@dataclass(frozen=True)
class WeightVariation:
    """The coefficient of variation of importance weights."""

    estimate: float  # χ̂ from the draws; infinite if all weights but one vanish
    # U, an upper bound of χ at the given confidence if the weights are no more heavy-tailed than these draws
    bound: float
    confidence: float  # confidence of the bound
    draws: float  # effective number of draws
    # Factor by which a standard deviation may exceed its estimate from these draws: U/χ̂, without noise
    inflation: float = 1.0

    def of_probability(self, p: float | np.ndarray) -> float | np.ndarray:
        """Largest error of the probability of an event."""
        return self.bound * np.sqrt(p * (1.0 - p))

    def of_variance(self, kurtosis: np.ndarray) -> np.ndarray:
        """Largest relative error of a variance."""
        return np.asarray(self.bound * np.sqrt(np.maximum(kurtosis, 1.0) - 1.0) + self.bound**2)


def weight_variation(
    log_ratios: Float[np.ndarray, " draw"], shares: Float[np.ndarray, " draw"], confidence: float
) -> WeightVariation:
    """Estimate χ from draws, and bound it."""
    shares = shares / shares.sum()
    count = weighted_size(shares)
    ran = np.isfinite(log_ratios)
    # A single effective draw contains no information on the variation of weights.
    if not ran.any() or count <= 1.0 + np.finfo(float).eps:
        return WeightVariation(np.inf, np.inf, confidence, count)
    weights = np.exp(log_ratios - log_ratios[ran].max())
    weights = weights / (shares @ weights)
    moments = [float(shares @ (weights - 1.0) ** power) for power in (2, 4)]
    if moments[0] == 0.0:
        return WeightVariation(0.0, 0.0, confidence, count)
    fourth = max(KURTOSIS, moments[1] / moments[0] ** 2) * moments[0] ** 2
    variation = float(np.sqrt(moments[0] * count / (count - 1.0)))
    plain, aided = (_bound(moments[0], fourth, noise, count, confidence) for noise in (0.0, NOISE))
    return WeightVariation(variation, min(plain, aided), confidence, count, plain / variation)


def _bound(variance: float, fourth: float, noise: float, count: float, confidence: float) -> float:
    """Return U, from weights with independent normal noise added, given the weights' variance and fourth moment."""
    spread = variance + noise**2
    kurtosis = (fourth + 6.0 * variance * noise**2 + 3.0 * noise**4) / spread**2
    freedom = 2.0 * (count - 1.0) / (kurtosis - 1.0)
    quantile = float(scipy.stats.chi2.ppf(1.0 - confidence, freedom))
    if quantile < LEAST_QUANTILE:
        return float("inf")
    unbiased = variance * count / (count - 1.0) + noise**2
    return float(np.sqrt(max(unbiased * freedom / quantile - noise**2, 0.0)))
