"""Training of parameter-dependent NARX coefficients, by least squares on the free-run error.

The coefficients of run k are ϑ_k = A ψ(ξ_k), where ψ are features of its parameters. One-step outputs are linear in A, but outputs
of a free run are not. Differentiation of the recursion gives the sensitivities J_k = ∂y_k/∂ϑ_k. The Gauss–Newton step has the
form of the joint one-step regression, with sensitivities instead of regressors:

    Σ_k w_k (J_kᵀJ_k ⊗ ψ_kψ_kᵀ) vec ΔA = Σ_k w_k (J_kᵀr_k ⊗ ψ_k)

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from structid.core.progress import Progress
from structid.surrogates.narx.training.free_run import FreeRun, robust_loss
from structid.surrogates.narx.training.one_step_regression import joint_solution
from structid.surrogates.narx.training.training_set import TrainingSet

SMALLEST_GAIN = 1e-3
"""Relative decrease of the loss below which the training ends."""


@dataclass
class Trained:
    """Trained coefficients and the history of their training."""

    coefficients: Float[np.ndarray, "coefficient feature"]  # A
    # Loss of each step, with mean and largest errors over the training runs and over the held-out runs
    history: list[dict[str, float]] = field(default_factory=list)


def train_free_run(
    runs: FreeRun,
    start: Float[np.ndarray, "coefficient feature"],
    features: Float[np.ndarray, "run feature"],
    data: TrainingSet,
    held_out: tuple[np.ndarray, TrainingSet] | None,
    steps: int,
    scale: float,
    progress: Progress | None = None,
) -> Trained:
    """Minimise the robust loss of the free-run error by Levenberg–Marquardt with iteratively updated weights.

    A step is accepted only if the loss decreases; otherwise the damping is raised. Therefore no step can make a good model
    diverge. The coefficients with the smallest loss on the held-out runs are kept.
    """
    current, damping = start, 1e-3
    errors = runs.errors(features @ current.T, data)
    loss = robust_loss(errors, scale, data.weights)
    best = Trained(start, [_entry(loss, errors, current, runs, held_out, scale)])
    lowest = best.history[-1]["judged"]
    for step in range(steps):
        square, inner = runs.normal_equations(features @ current.T, data)
        weights = 1.0 / (scale + errors)  # derivative of the loss with respect to ε
        square = np.einsum("ro,roij->rij", weights, square)
        inner = np.einsum("ro,roi->ri", weights, inner)
        gained = 0.0
        for _ in range(6):
            trial = current + joint_solution(square, inner, features, data.weights, damping)
            trial_errors = runs.errors(features @ trial.T, data)
            gained = loss - robust_loss(trial_errors, scale, data.weights)
            if gained > 0:
                break
            damping *= 10.0
        if gained <= 0:
            break
        current, errors, loss, damping = trial, trial_errors, loss - gained, max(damping / 5.0, 1e-10)
        best.history.append(_entry(loss, errors, current, runs, held_out, scale))
        if best.history[-1]["judged"] < lowest:
            best.coefficients, lowest = current, best.history[-1]["judged"]
        if progress is not None:
            progress(step + 1, steps)
        if gained < SMALLEST_GAIN * loss:
            break
    return best


def _entry(
    loss: float,
    errors: np.ndarray,
    current: np.ndarray,
    runs: FreeRun,
    held_out: tuple[np.ndarray, TrainingSet] | None,
    scale: float,
) -> dict[str, float]:
    """Return one entry of the history; ``judged`` is the loss that determines the kept coefficients."""
    entry = {"loss": loss, "mean": float(errors.mean()), "worst": float(errors.max()), "judged": loss}
    if held_out is not None:
        features, data = held_out
        unseen = runs.errors(features @ current.T, data)
        entry |= {"held_out_mean": float(unseen.mean()), "held_out_worst": float(unseen.max())}
        entry["judged"] = robust_loss(unseen, scale, data.weights)
    return entry


def refined_coefficients(
    runs: FreeRun,
    start: Float[np.ndarray, "run coefficient"],
    data: TrainingSet,
    steps: int,
    progress: Progress | None = None,
) -> Float[np.ndarray, "run coefficient"]:
    """Refine the coefficients of every run on its free run: a maximum a posteriori around given values, by Gauss–Newton.

    The prior standard deviation is a tenth of the standard deviation of the given coefficients over the runs. The noise is the
    residual error of the given coefficients.
    """
    deviation = 0.1 * np.maximum(start.std(axis=0), 1e-3 * np.abs(start).max(axis=0) + 1e-9)
    current = start
    errors = runs.errors(current, data).mean(axis=1)
    noise = max(float(np.median(errors)), 1e-12) / data.y.shape[1]
    for step in range(steps):
        square, inner = runs.normal_equations(current, data)
        square, inner = square.mean(axis=1) / noise, inner.mean(axis=1) / noise
        # In units of the prior standard deviation, the prior covariance is the identity and the system is well conditioned.
        matrix = square * deviation[:, None] * deviation + np.eye(len(deviation))
        right = inner * deviation - (current - start) / deviation
        trial = current + np.linalg.solve(matrix, right[:, :, None])[:, :, 0] * deviation
        result = runs.errors(trial, data).mean(axis=1)
        better = result < errors
        current = np.where(better[:, None], trial, current)
        errors = np.where(better, result, errors)
        if progress is not None:
            progress(step + 1, steps)
    return current
