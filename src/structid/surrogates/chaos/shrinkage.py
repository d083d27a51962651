"""Polynomial chaos with more terms than runs: coefficients shrink with the degree, at rates estimated from the runs.

The prior is c_α ~ N(0, σ² λ_α) with λ_α = Π_j exp(−2 wⱼ αⱼ), because the coefficients of an analytic function decay geometrically.
The covariance of an output is σ² (Ψ Λ Ψᵀ + g I). The decay rates w and the noise g maximise the joint evidence of all outputs. The
posterior mean c = Λ Ψᵀ (Ψ Λ Ψᵀ + g I)⁻¹ y interpolates if g is small, and smooths otherwise. The basis contains the terms with the
largest λ_α, so a parameter with slowly decaying coefficients gets a high degree. (Minimum-norm polynomial approximation: Rauhut &
Ward 2016, doi 10.1016/j.acha.2015.02.003; evidence: Rasmussen & Williams 2006, section 5.4.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float, Int

from structid.probability.space import ParameterSpace
from structid.surrogates.chaos.polynomial_basis import PolynomialBasis, box_variables
from structid.surrogates.covariance_factors import inverse_of, raised_cholesky
from structid.surrogates.quasi_newton import quasi_newton

LOG_RATES = (-4.0, 2.5)
"""Range of the logarithm of a decay rate."""

LOG_NOISES = (-32.0, 3.0)
"""Range of the logarithm of the noise."""

SMALLEST_NOISE = 1e-12
"""Smallest noise, as a fraction of the mean prior variance of the outputs."""

MOST_TERMS = 2500
"""Largest number of terms in the basis."""

LARGEST_DEGREE = 60
"""Largest degree of one parameter."""

NEGLIGIBLE = 1e-11
"""Fraction of the coefficients' energy (sum of squares) that may be omitted."""

ROUNDS = 3
"""Number of selections of the basis, each with the current decay rates."""


@dataclass(frozen=True, eq=False)
class ShrunkFit:
    """A fitted expansion with shrunk coefficients."""

    basis: PolynomialBasis  # Legendre polynomials on the range of the design
    coefficients: Float[np.ndarray, "term output"]  # Posterior means
    # Mean squared leave-one-out residual relative to the variance of each output
    leave_one_out_error: Float[np.ndarray, " output"]
    rates: Float[np.ndarray, " parameter"]  # Decay rates w


def fit_shrunk(
    space: ParameterSpace, theta: Float[np.ndarray, "run parameter"], outputs: Float[np.ndarray, "run output"]
) -> ShrunkFit:
    """Fit all outputs with the same decay rates; the weight of an output is proportional to its variance."""
    dimension = theta.shape[1]
    variables = box_variables(space, theta)
    low, high = variables.min(axis=0), variables.max(axis=0)
    box = np.stack([low, np.where(high > low, high, low + 1.0)], axis=1)
    most = min(MOST_TERMS, 5 * len(theta) + 100)
    parameters = np.append(np.full(dimension, -0.7), -12.0)
    for number in range(ROUNDS):
        indices = weighted_indices(np.exp(parameters[:dimension]), most if number == ROUNDS - 1 else most // 2)
        basis = PolynomialBasis(space, indices, box)
        evidence = _Evidence(basis.evaluate(theta), indices, outputs - outputs.mean(axis=0))
        parameters, _, _ = quasi_newton(evidence, evidence.bounds, parameters, np.eye(dimension + 1) / len(theta))
    coefficients, residuals = evidence.solution(parameters)
    coefficients[0] += outputs.mean(axis=0)
    error = np.mean(residuals**2, axis=0) / outputs.var(axis=0)
    kept = _worth_keeping(indices, coefficients)
    return ShrunkFit(basis[kept], coefficients[kept], error, np.exp(parameters[:dimension]))


def _worth_keeping(indices: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return the positions of the non-negligible terms, and of lower-degree terms for a downward-closed set."""
    energy = np.sum(coefficients**2, axis=1)
    rising = np.argsort(energy)
    needed = np.ones(len(energy), dtype=bool)
    needed[rising[np.cumsum(energy[rising]) < NEGLIGIBLE * energy[1:].sum()]] = False
    # Add the lower neighbours of every kept term, from the highest degree down.
    row_of_index = {tuple(index): row for row, index in enumerate(indices)}
    for row in np.argsort(-indices.sum(axis=1), kind="stable"):
        if needed[row]:
            for j in np.flatnonzero(indices[row]):
                lower = indices[row].copy()
                lower[j] -= 1
                needed[row_of_index[tuple(lower)]] = True
    return np.flatnonzero(needed)


def weighted_indices(rates: Float[np.ndarray, " parameter"], most: int) -> Int[np.ndarray, "term parameter"]:
    """Return the multi-indices with the smallest Σ wⱼ αⱼ, as a downward-closed set."""
    budget = rates.min()
    while True:
        indices = _within(rates, budget)
        if len(indices) >= most or budget > LARGEST_DEGREE * rates.max():
            break
        budget *= 1.3
    # Multi-indices of equal weight are sorted by degree, so that the set stays downward closed.
    order = np.lexsort((indices.sum(axis=1), np.round(indices @ rates, 12)))
    return indices[order[:most]]


def _within(rates: np.ndarray, budget: float) -> np.ndarray:
    """Return all multi-indices with Σ wⱼ αⱼ ≤ budget, shape (n, parameter)."""
    rows, spent = np.zeros((1, 0), dtype=int), np.zeros(1)
    for rate in rates:
        reach = np.minimum((budget - spent) / rate + 1e-9, LARGEST_DEGREE).astype(int)
        degrees = np.concatenate([np.arange(r + 1) for r in reach])
        parents = np.repeat(np.arange(len(rows)), reach + 1)
        rows = np.column_stack([rows[parents], degrees])
        spent = spent[parents] + rate * degrees
    return rows


class _Evidence:
    """Negative log evidence N/2 log σ̂² + ½ log|C|, C = Ψ Λ Ψᵀ + g I, with its gradient with respect to log w and log g."""

    def __init__(self, columns: np.ndarray, indices: np.ndarray, outputs: np.ndarray) -> None:
        self.columns, self.indices, self.outputs = columns, indices.astype(np.float64), outputs
        self.bounds = [LOG_RATES] * indices.shape[1] + [LOG_NOISES]

    def _prior(self, parameters: np.ndarray) -> np.ndarray:
        """Return the prior variances λ_α, shape (term,)."""
        return np.asarray(np.exp(-2.0 * self.indices @ np.exp(parameters[:-1])))

    def _factor(self, parameters: np.ndarray) -> np.ndarray:
        """Return the lower Cholesky factor of C; the noise stays above the rounding error of the sum."""
        scaled = self.columns * np.sqrt(self._prior(parameters))
        matrix = scaled @ scaled.T
        noise = max(float(np.exp(parameters[-1])), SMALLEST_NOISE * float(np.trace(matrix)) / len(matrix))
        return raised_cholesky(matrix, noise)[0]

    def __call__(self, parameters: np.ndarray) -> tuple[float, np.ndarray]:
        factor = self._factor(parameters)
        inverse = inverse_of(factor)
        runs, outputs = self.outputs.shape
        weights = scipy.linalg.cho_solve((factor, True), self.outputs)
        variance = float(np.sum(weights * self.outputs)) / (runs * outputs)
        value = 0.5 * runs * np.log(variance) + float(np.sum(np.log(np.diag(factor))))
        by_matrix = 0.5 * (inverse - weights @ weights.T / (variance * outputs))
        # d C / d log wⱼ = −2 wⱼ Σ_α αⱼ λ_α ψ_αψ_αᵀ
        share = self._prior(parameters) * np.einsum("ia,ia->a", self.columns, by_matrix @ self.columns)
        slope = -2.0 * np.exp(parameters[:-1]) * (self.indices.T @ share)
        return value, np.append(slope, np.exp(parameters[-1]) * np.trace(by_matrix))

    def solution(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return coefficients (term, output) and leave-one-out residuals (run, output)."""
        factor = self._factor(parameters)
        weights = scipy.linalg.cho_solve((factor, True), self.outputs)
        coefficients = self._prior(parameters)[:, None] * (self.columns.T @ weights)
        return coefficients, weights / np.diag(inverse_of(factor))[:, None]
