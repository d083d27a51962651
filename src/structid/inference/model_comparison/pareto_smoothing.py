"""Pareto-smoothed importance sampling: the largest weights are replaced by quantiles of a fitted tail.

Sources: Vehtari, Simpson, Gelman, Yao & Gabry (2024, JMLR 25(72)); the tail is fitted as in Zhang & Stephens (2009,
Technometrics 51, 316).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

SMALLEST_TAIL = 5
"""Minimum number of draws in the tail; with fewer, k̂ is infinite."""

PRIOR_DRAWS, PRIOR_K = 10.0, 0.5
"""Weight of the prior on the fitted shape, in draws, and the shape's prior value (Vehtari et al., appendix C)."""


def smoothed_weights(log_ratios: Float[np.ndarray, " draw"]) -> tuple[np.ndarray, float]:
    """Pareto-smoothed importance weights and their tail index."""
    count, alive = len(log_ratios), np.isfinite(log_ratios)
    if not alive.any():
        return np.full(count, 1.0 / count), float("inf")
    if alive.all() and np.ptp(log_ratios) < 1e-9:
        return np.full(count, 1.0 / count), float("-inf")
    weights = np.exp(log_ratios - log_ratios[alive].max())
    k_hat = _smooth_tail(weights)
    return weights / weights.sum(), k_hat


def _smooth_tail(weights: np.ndarray) -> float:
    """Replace the largest weights, in place, by expected order statistics of a fitted Pareto tail; return k̂."""
    count = len(weights)
    # M = min(S/5, 3 √S) draws are the tail.
    length = int(np.ceil(min(count / 5.0, 3.0 * np.sqrt(count))))
    order = np.argsort(weights, kind="stable")
    cutoff = max(float(weights[order[-length - 1]]), float(np.finfo(float).tiny))
    tail = order[weights[order] > cutoff]
    if len(tail) < SMALLEST_TAIL:
        return float("inf")
    excess = weights[tail] - cutoff
    k, scale = pareto_fit(excess)
    if not np.isfinite(k):
        return float("inf")
    probability = (np.arange(len(tail)) + 0.5) / len(tail)
    # No smoothed weight exceeds the largest original weight.
    weights[tail] = np.minimum(cutoff + _pareto_quantile(probability, k, scale), 1.0)
    return k


def pareto_fit(excess: Float[np.ndarray, " draw"]) -> tuple[float, float]:
    """Fit a generalised Pareto distribution, 1 − F(x) = (1 + k x/σ)^(−1/k), by Zhang & Stephens' empirical-Bayes estimate.

    With θ = −k/σ the profile likelihood of n draws is L(θ) = exp{n (log(−θ/k(θ)) − k(θ) − 1)}, k(θ) = mean log(1 − θ x). θ is the
    likelihood-weighted mean over a grid that their prior suggests.
    """
    count = len(excess)
    points = 30 + int(np.sqrt(count))
    quartile = excess[int(count / 4.0 + 0.5) - 1]
    if quartile <= excess[0]:  # a quarter of the values are equal: no Pareto distribution
        return float("nan"), float("nan")
    with np.errstate(all="ignore"):
        grid = 1.0 / excess[-1] + (1.0 - np.sqrt(points / (np.arange(1, points + 1) - 0.5))) / (3.0 * quartile)
        shapes = np.log1p(-grid[:, None] * excess).mean(axis=1)
        log_likelihood = count * (np.log(-grid / shapes) - shapes - 1.0)
        likelihood = np.exp(log_likelihood - log_likelihood.max())
        theta = float(np.sum(grid * likelihood) / likelihood.sum())
        k = float(np.log1p(-theta * excess).mean())
        scale = -k / theta
    return (count * k + PRIOR_DRAWS * PRIOR_K) / (count + PRIOR_DRAWS), scale


def _pareto_quantile(probability: np.ndarray, k: float, scale: float) -> np.ndarray:
    """σ ((1 − p)^(−k) − 1)/k."""
    log_rest = np.log1p(-probability)
    return np.asarray(-scale * log_rest if abs(k) < 1e-12 else scale * np.expm1(-k * log_rest) / k)
