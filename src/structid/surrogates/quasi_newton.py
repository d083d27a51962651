"""A quasi-Newton search within bounds, for objectives that are noisy in their last digits."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

MOST_STEPS, MOST_REDUCTIONS = 40, 4
"""Largest number of steps, and largest number of reductions of a step's length."""

LONGEST_STEP = 1.5
"""Largest change of a (logarithmic) coordinate in one step."""

SMALLEST_GAIN = 0.02
"""Predicted gain of the log likelihood below which the search ends."""


def quasi_newton(
    objective: Callable[[np.ndarray], tuple[float, np.ndarray]],
    bounds: Sequence[tuple[float, float]],
    start: Float[np.ndarray, " coordinate"],
    covariance: Float[np.ndarray, "coordinate coordinate"],
) -> tuple[np.ndarray, np.ndarray, float]:
    """Minimise by BFGS within bounds (Nocedal & Wright 2006, eq. 6.17), until the predicted gain is negligible.

    Nearly singular correlation matrices make a likelihood noisy, so a line search that requires an exact decrease would not end.
    """
    low, high = np.array(bounds).T
    point, (value, slope) = start, objective(start)
    for _ in range(MOST_STEPS):
        free = ((point > low) | (slope < 0)) & ((point < high) | (slope > 0))
        direction = -np.where(free, covariance @ np.where(free, slope, 0.0), 0.0)
        if -0.5 * direction @ slope < SMALLEST_GAIN:
            break
        direction *= min(1.0, LONGEST_STEP / np.abs(direction).max())
        for _ in range(MOST_REDUCTIONS):
            trial = np.clip(point + direction, low, high)
            trial_value, trial_slope = objective(trial)
            if trial_value < value + 1e-4 * slope @ (trial - point) + 1e-9 * abs(value):
                break
            direction *= 0.3
        else:
            break
        step, bend = trial - point, trial_slope - slope
        if step @ bend > 1e-8 * np.linalg.norm(step) * np.linalg.norm(bend):
            left = np.eye(len(step)) - np.outer(step, bend) / (step @ bend)
            covariance = left @ covariance @ left.T + np.outer(step, step) / (step @ bend)
        point, value, slope = trial, trial_value, trial_slope
    return point, covariance, value
