"""One-step regression of NARX coefficients; one-step outputs are linear in the coefficients.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from structid.core.progress import Progress, Steps
from structid.surrogates.narx.structure.recursion import Recursion
from structid.surrogates.narx.training.free_run import FreeRun, robust_loss
from structid.surrogates.narx.training.training_set import TrainingSet, spread_rows

FIRST_SHAPES = (0.1, 0.25, 0.6, 1.5)
"""Initial values of the hysteresis shape b, relative to the magnitude of the source signal; g starts from zero."""

RIDGES = (1e-10, 1e-8, 1e-6, 1e-4)
"""Ridge parameters to try in the joint regression."""

TRIED_RUNS = 100
"""Largest number of runs on which initial coefficients and sets of terms are compared."""


def joint_solution(
    square: Float[np.ndarray, "run coefficient coefficient"],
    inner: Float[np.ndarray, "run coefficient"],
    features: Float[np.ndarray, "run feature"],
    weights: Float[np.ndarray, " run"],
    ridge: float,
) -> Float[np.ndarray, "coefficient feature"]:
    """Solve the joint normal equations, scaled to a unit diagonal, with a ridge.

    Σ_k w_k (G_k ⊗ ψ_kψ_kᵀ) vec A = Σ_k w_k (g_k ⊗ ψ_k). G_k is ΦᵀΦ of the one-step regression, or JᵀJ of a Gauss–Newton step.
    """
    size, width = square.shape[1], features.shape[1]
    # Compute Σ_k w_k G_k ⊗ ψ_kψ_kᵀ as one matrix product.
    outer = (features[:, :, None] * features[:, None, :]).reshape(len(features), -1)
    matrix = (square * weights[:, None, None]).reshape(len(features), -1).T @ outer
    matrix = matrix.reshape(size, size, width, width).transpose(0, 2, 1, 3).reshape(size * width, size * width)
    right = np.einsum("r,ri,rp->ip", weights, inner, features, optimize=True).ravel()
    scale = np.sqrt(np.diag(matrix))
    scale = np.where(scale > 0, scale, 1.0)
    matrix = matrix / scale[:, None] / scale + ridge * np.eye(len(matrix))
    return np.asarray(np.linalg.solve(matrix, right / scale) / scale).reshape(size, width)


def first_coefficients(
    runs: FreeRun,
    features: Float[np.ndarray, "run feature"],
    data: TrainingSet,
    ridges: Sequence[float] = RIDGES,
    progress: Progress | None = None,
) -> Float[np.ndarray, "coefficient feature"]:
    """Fit A by joint one-step regression; free runs of some experiments determine the hysteresis shapes and the ridge."""
    recursion = runs.recursion
    tried = spread_rows(data.weights, TRIED_RUNS)
    best, lowest = np.zeros((recursion.size, features.shape[1])), np.inf
    shapes = FIRST_SHAPES if any(m.shapes for m in recursion.memories) else (0.0,)
    step_done = Steps(progress, len(shapes) * len(ridges))
    for shape in shapes:
        vector = constant_shapes(recursion, shape)
        square, inner = runs.regression_equations(np.tile(vector, (len(data), 1)), data)
        square, inner = square.sum(axis=1), inner.sum(axis=1)
        for ridge in ridges:
            solution = joint_solution(square, inner, features, data.weights, ridge)
            solution[recursion.linear_size :, 0] = vector[recursion.linear_size :]
            loss = robust_loss(runs.errors(features[tried] @ solution.T, data[tried]), 1e-3)
            if loss < lowest:
                best, lowest = solution, loss
            step_done()
    return best


def constant_shapes(recursion: Recursion, shape: float) -> Float[np.ndarray, " coefficient"]:
    """Return a coefficient vector with only shape parameters: a given b, and g = 0."""
    vector = np.zeros(recursion.size)
    vector[recursion.linear_size :: 2] = shape
    return vector


def per_experiment_solution(
    recursion: Recursion, square: np.ndarray, inner: np.ndarray, vector: Float[np.ndarray, " coefficient"]
) -> Float[np.ndarray, "run coefficient"]:
    """Fit the coefficients of every experiment separately by ordinary least squares (thesis eq. 2.62)."""
    coefficients = np.tile(vector, (len(square), 1))
    start = 0
    for output, terms in enumerate(recursion.terms):
        columns = slice(start, start + len(terms))
        coefficients[:, columns] = batched_solution(square[:, output, columns, columns], inner[:, output, columns])
        start += len(terms)
    return coefficients


def least_squares_of_each(runs: FreeRun, data: TrainingSet) -> Float[np.ndarray, "run coefficient"]:
    """Fit one-step coefficients of every experiment separately, with the initial parameters of the hysteretic memories."""
    vector = constant_shapes(runs.recursion, FIRST_SHAPES[1])
    equations = runs.regression_equations(np.tile(vector, (len(data), 1)), data)
    return per_experiment_solution(runs.recursion, *equations, vector)


def batched_solution(
    gram: Float[np.ndarray, "run term term"], covariance: Float[np.ndarray, "run term"]
) -> Float[np.ndarray, "run term"]:
    """Solve many small normal equations, scaled to a unit diagonal, with a ridge at the level of rounding."""
    scale = np.sqrt(np.maximum(np.einsum("rii->ri", gram), 1e-300))
    standard = gram / scale[:, :, None] / scale[:, None, :] + 1e-12 * np.eye(gram.shape[1])
    return np.asarray(np.linalg.solve(standard, (covariance / scale)[:, :, None])[:, :, 0] / scale)
