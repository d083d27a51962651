"""Hyper-parameters of Kriging (correlation lengths and nugget): their objective, and the search for its minimum."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.progress import Steps
from structid.surrogates.covariance_factors import inverse_of
from structid.surrogates.kriging.correlation_matrices import CorrelationMatrices
from structid.surrogates.kriging.kriging_system import (
    KrigingData,
    generalised_least_squares,
    raised_correlation_cholesky,
)
from structid.surrogates.quasi_newton import quasi_newton

LOG_LENGTHS = (-4.0, 7.0)
"""Range of the logarithm of a correlation length, in standard deviations of the design."""

LOG_NUGGETS = (-25.0, 0.0)
"""Range of the logarithm of an estimated nugget, relative to the process variance."""

GLOBAL_POINTS, SCREENING_POINTS = 100, 250
"""Number of design points for the global search, and for the first stage of the local search."""


class HyperparameterObjective:
    """The objective of the hyper-parameters with its exact gradient; all outputs share one variance.

    Maximum likelihood, profiled over β and σ²: N/2 log σ̂² + ½ log|C|. Its derivative with respect to C is
    ½ (C⁻¹ − w wᵀ/σ̂²).
    Cross-validation: N/2 log Σ eᵢ². The derivative of Σ eᵢ² with respect to Q is M with
    M_ij = 2 eᵢ yⱼ/Qᵢᵢ − δ_ij 2 eᵢ²/Qᵢᵢ, and dQ = −Q dC Q.

    The argument is the vector of log correlation lengths, followed by the log nugget if it is estimated.
    """

    def __init__(self, data: KrigingData, family: str, separable: bool, nugget: float | str, estimation: str) -> None:
        self.data, self.family, self.separable = data, family, separable
        self.nugget, self.estimation = nugget, estimation
        self.lengths = data.points.shape[1]

    def on(self, data: KrigingData) -> HyperparameterObjective:
        """Return the same objective for other runs."""
        return HyperparameterObjective(data, self.family, self.separable, self.nugget, self.estimation)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Range of each hyper-parameter."""
        return [LOG_LENGTHS] * self.lengths + [LOG_NUGGETS] * (self.nugget == "estimate")

    def matrix(self, parameters: Float[np.ndarray, " hyperparameter"]) -> Float[np.ndarray, "run run"]:
        """Compute the correlations of the points."""
        return self._correlations.of(parameters[: self.lengths])

    @cached_property
    def _correlations(self) -> CorrelationMatrices:
        return CorrelationMatrices(self.family, self.separable, self.data.points)

    def diagonal(self, parameters: Float[np.ndarray, " hyperparameter"]) -> float:
        """Return the nugget."""
        return float(np.exp(parameters[-1])) if self.nugget == "estimate" else float(self.nugget)

    def values(self, parameters: Float[np.ndarray, "hyperparameter point"]) -> Float[np.ndarray, " point"]:
        """Evaluate the objective at many points, without gradients."""
        matrices = self._correlations.of_several(parameters[: self.lengths].T)
        return np.array([self._of(p, matrix, False)[0] for p, matrix in zip(parameters.T, matrices, strict=True)])

    def __call__(self, parameters: np.ndarray) -> tuple[float, np.ndarray]:
        """Evaluate the objective and its gradient with respect to log lengths and log nugget."""
        return self._of(parameters, self.matrix(parameters), True)

    def _of(self, parameters: np.ndarray, matrix: np.ndarray, gradient: bool) -> tuple[float, np.ndarray]:
        """Return the objective, and on request its gradient, from the correlations of the points."""
        try:
            cholesky, nugget = raised_correlation_cholesky(matrix, self.diagonal(parameters))
            by_matrix = self._likelihood if self.estimation == "ml" else self._cross_validation
            value, weights = by_matrix(cholesky, gradient)
        except np.linalg.LinAlgError:
            return 1e25, np.zeros(len(parameters))
        if not gradient:
            return value, np.empty(0)
        slope = self._correlations.gradient(parameters[: self.lengths], weights)
        if self.nugget == "estimate":
            slope = np.append(slope, nugget * np.trace(weights))
        return value, slope

    def _likelihood(self, cholesky: np.ndarray, gradient: bool) -> tuple[float, np.ndarray]:
        """Return the negative log likelihood and its derivative with respect to C."""
        runs, outputs = self.data.outputs.shape
        _, _, coefficients, weights = generalised_least_squares(self.data, cholesky)
        error = self.data.outputs - self.data.trend @ coefficients
        variance = float(np.sum(error * weights)) / (runs * outputs)
        value = 0.5 * runs * np.log(variance) + np.sum(np.log(np.diag(cholesky)))
        if not gradient:
            return float(value), np.empty(0)
        return float(value), 0.5 * (inverse_of(cholesky) - weights @ weights.T / (variance * outputs))

    def _cross_validation(self, cholesky: np.ndarray, gradient: bool) -> tuple[float, np.ndarray]:
        """Return N/2 log Σ eᵢ² of the leave-one-out residuals e, and its derivative with respect to C."""
        solved_trend, trend_covariance, _, weights = generalised_least_squares(self.data, cholesky)
        q = inverse_of(cholesky) - solved_trend @ trend_covariance @ solved_trend.T
        precision = np.diag(q)
        error = weights / precision[:, None]
        total = float(np.sum(error**2))
        value = 0.5 * len(q) * np.log(total)
        if not gradient:
            return float(value), np.empty(0)
        by_inverse = q @ (2.0 * error / precision[:, None]) @ weights.T
        by_inverse -= (q * (2.0 * np.sum(error**2, axis=1) / precision)) @ q
        return float(value), -0.5 * len(q) / total * by_inverse


def stage_sizes(runs: int) -> list[int]:
    """Return the number of runs in each stage of the search: all runs in the last stage, half as many in the stage before, …."""
    sizes = [runs]
    while sizes[-1] > 2 * SCREENING_POINTS:
        sizes.append(sizes[-1] // 2)
    return sizes[::-1]


def search_hyperparameters(
    objective: HyperparameterObjective, starts: int, rng: np.random.Generator, step_done: Steps
) -> Float[np.ndarray, " hyperparameter"]:
    """Find the hyper-parameters globally by differential evolution on part of the design, then locally on growing parts.

    The local search makes quasi-Newton steps on part of the design, then on twice as many runs, and finally on all
    runs. The curvature found on one part, scaled by the number of runs, starts the search on the next, so few steps
    need all runs.
    """
    data = objective.data
    order = rng.permutation(len(data.points))
    parts = stage_sizes(len(data.points))[:-1]
    stages = [objective.on(data.some(np.sort(order[:size]))) for size in parts] + [objective]
    screening = objective.on(data.some(np.sort(order[:SCREENING_POINTS])))
    bounds = objective.bounds
    coarse = objective.on(data.some(np.sort(order[: max(GLOBAL_POINTS, 2 * data.trend.shape[1])])))
    optimum = scipy.optimize.differential_evolution(
        coarse.values,
        bounds,
        init=_first_generation(bounds, 8 * len(bounds), rng),
        maxiter=12,
        polish=False,
        rng=rng,
        vectorized=True,
        updating="deferred",
    )
    best, lowest = optimum.x, np.inf
    for start in optimum.population[np.argsort(optimum.population_energies)[: max(starts, 1)]]:
        parameters = scipy.optimize.minimize(screening, start, jac=True, method="L-BFGS-B", bounds=bounds).x
        covariance = _inverse_curvature(screening, parameters)
        runs = len(screening.data.points)
        for stage in stages:
            covariance = covariance * (runs / len(stage.data.points))
            parameters, covariance, value = quasi_newton(stage, stage.bounds, parameters, covariance)
            runs = len(stage.data.points)
            step_done()
        if value < lowest:
            best, lowest = parameters, value
    return np.asarray(best)


def refined_hyperparameters(
    objective: HyperparameterObjective, start: Float[np.ndarray, " hyperparameter"], step_done: Steps
) -> Float[np.ndarray, " hyperparameter"]:
    """Find the hyper-parameters by quasi-Newton steps on the whole design, from a start near the optimum."""
    parameters = np.clip(start, *np.array(objective.bounds).T)
    parameters, _, _ = quasi_newton(objective, objective.bounds, parameters, _inverse_curvature(objective, parameters))
    step_done()
    return parameters


def _inverse_curvature(objective: HyperparameterObjective, parameters: np.ndarray) -> np.ndarray:
    """Return the inverse matrix of second derivatives, from differences of gradients; flat directions get a finite value."""
    step = 1e-3
    slopes = [
        (objective(parameters + step * e)[1] - objective(parameters - step * e)[1]) / (2 * step)
        for e in np.eye(len(parameters))
    ]
    values, vectors = np.linalg.eigh(0.5 * (np.array(slopes) + np.array(slopes).T))
    return np.asarray((vectors / np.maximum(values, 1.0)) @ vectors.T)


def _first_generation(bounds: list[tuple[float, float]], count: int, rng: np.random.Generator) -> np.ndarray:
    """Return the first generation of the global search, a Latin hypercube sample within the bounds."""
    low, high = np.array(bounds).T
    return np.asarray(low + (high - low) * scipy.stats.qmc.LatinHypercube(len(bounds), rng=rng).random(count))
