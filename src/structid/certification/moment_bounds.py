"""Bounds on the errors of means, standard deviations and correlations from the variation of the weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy
from jaxtyping import Float

from structid.certification.fresh_draws import FreshDraws
from structid.certification.weight_variation import WeightVariation


def standardised(fresh: FreshDraws) -> Float[np.ndarray, "draw parameter"]:
    """Return the distances of the draws from the mean of q, in standard deviations of q."""
    return _in_sds(fresh.compared, fresh.population)


def shift(fresh: FreshDraws, values: Float[np.ndarray, "draw function"]) -> tuple[np.ndarray, np.ndarray]:
    """E_q (w − 1) f of functions of the parameters."""
    plain = fresh.shares / fresh.shares.sum()
    shifts = (fresh.weights - plain) @ values
    # Error of a self-normalised estimate.
    contributions = (fresh.weights - plain)[:, None] * values - fresh.weights[:, None] * shifts
    return shifts, np.sqrt(np.sum(contributions**2, axis=0))


def mean_bound(fresh: FreshDraws, variation: WeightVariation) -> Float[np.ndarray, " parameter"]:
    """Bound on the error of each mean, in standard deviations.

    The smaller of two bounds applies: χ, which assumes the worst possible weights, and the shift E_q (w − 1) z by the draws plus
    its error; see `sd_bound`. Weights that vary in many directions, by little in each, shift every mean by much less than χ.
    """
    estimate, error = shift(fresh, standardised(fresh))
    with np.errstate(invalid="ignore"):  # the variation may be infinite
        return np.asarray(np.fmin(_by_draws(estimate, error, variation), variation.bound))


def _by_draws(estimate: np.ndarray, error: np.ndarray, variation: WeightVariation) -> np.ndarray:
    """Largest size of every estimate; errors are enlarged by the same factor as χ."""
    # For the means and the standard deviations of all parameters together.
    quantile = scipy.stats.norm.isf(0.5 * (1.0 - variation.confidence) / (2.0 * len(estimate)))
    return np.asarray(np.abs(estimate) + quantile * variation.inflation * error)


def sd_bound(fresh: FreshDraws, variation: WeightVariation) -> Float[np.ndarray, " parameter"]:
    """Bound on the relative error of each standard deviation.

    The smaller of two bounds on the shift of the variance applies. The bound by χ assumes the worst possible weights.
    The bound by the draws is E_q (w − 1) z² plus its error. This error is enlarged by the same factor as χ, and all
    parameters are bounded simultaneously. The bound by the draws is usually smaller for a marginal with long tails.
    """
    estimate, error = shift(fresh, standardised(fresh) ** 2 - 1.0)
    with np.errstate(invalid="ignore"):  # the variation may be infinite
        by_draws = _by_draws(estimate, error, variation) + variation.bound**2
    by_variation = variation.of_variance(_kurtosis(fresh.population))
    return _of_sd(np.fmin(by_draws, by_variation))


def correlation_bound(fresh: FreshDraws, variation: WeightVariation) -> Float[np.ndarray, "parameter parameter"]:
    """Bound on the error of the correlation of each pair of parameters.

    A correlation ρ changes by E_q (w − 1) f to first order, with f = z₁ z₂ − ½ ρ (z₁² + z₂²) of the standardised parameters. This
    is at most χ sd_q(f), or χ (1 − ρ²) for normal parameters, and χ² bounds the effect of the means.
    """
    z = _in_sds(fresh.population, fresh.population)
    rho, cubes, squares = (power.T @ other / len(z) for power, other in ((z, z), (z**3, z), (z**2, z**2)))
    fourth = np.diag(squares)
    # E f² = E z₁² z₂² − ρ E (z₁³ z₂ + z₁ z₂³) + ¼ ρ² E (z₁² + z₂²)², and E f = 0.
    spread = squares - rho * (cubes + cubes.T) + 0.25 * rho**2 * (fourth[:, None] + 2.0 * squares + fourth)
    square = variation.bound**2
    with np.errstate(invalid="ignore"):  # the variation may be infinite
        bound = np.fmax(variation.bound * np.sqrt(np.maximum(spread, 0.0)) + square, square)
    np.fill_diagonal(bound, 0.0)
    return np.asarray(bound)


def missing_bounds(fresh: FreshDraws, variation: WeightVariation) -> tuple[float, np.ndarray]:
    """Bounds on the errors of means and standard deviations if q is zero where a fraction δ of π lies.

    If q is right elsewhere, dq/dπ = 1/(1 − δ) in the support of q, and zero elsewhere: χ = √(δ/(1 − δ)).
    """
    lost = float(np.sqrt(fresh.missing / (1.0 - fresh.missing))) if fresh.missing < 1.0 else float("inf")
    return lost, _of_sd(replace(variation, bound=lost).of_variance(_kurtosis(fresh.population)))


def _of_sd(of_variance: np.ndarray) -> np.ndarray:
    """Largest relative error of a standard deviation, from the largest relative error of its variance."""
    return np.asarray(1.0 - np.sqrt(np.maximum(1.0 - of_variance, 0.0)))


def _kurtosis(draws: np.ndarray) -> np.ndarray:
    """E (x − μ)⁴ / σ⁴ of every marginal."""
    return np.asarray(np.mean(_in_sds(draws, draws) ** 4, axis=0))


def _in_sds(values: np.ndarray, population: np.ndarray) -> np.ndarray:
    """Distances from a population's mean in its standard deviations; plain distances if it has no spread."""
    sd = population.std(axis=0)
    return np.asarray((values - population.mean(axis=0)) / np.where(sd > 0.0, sd, 1.0))
