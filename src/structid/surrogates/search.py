"""A quasi-Newton search within bounds for objectives that are noisy in their last digits."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

MOST_STEPS, MOST_HALVINGS = 40, 4
LONGEST_STEP = 1.5
"""Of a logarithm, in one step of the search."""
SMALLEST_GAIN = 0.02
"""Of the log likelihood; a step that promises less ends the search."""


def quasi_newton(
    objective: Callable[[np.ndarray], tuple[float, np.ndarray]],
    bounds: Sequence[tuple[float, float]],
    start: np.ndarray,
    covariance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float]:
    """BFGS within bounds (Nocedal & Wright 2006, eq. 6.17) that ends when a step would gain next to nothing.

    Near-singular correlation matrices make a likelihood noisy: a line search that looks for an exact decrease would not end.

    Parameters
    ----------
    objective : callable
        Value and gradient at a point.
    bounds : sequence of tuple
        Smallest and largest value of each coordinate.
    start : ndarray, shape (coordinate,)
        Where to start.
    covariance : ndarray, shape (coordinate, coordinate)
        Guess of the inverse of the second derivatives.

    Returns
    -------
    tuple
        The best point, the inverse second derivatives found, and the value there.
    """
    low, high = np.array(bounds).T
    place, (value, slope) = start, objective(start)
    for _ in range(MOST_STEPS):
        free = ((place > low) | (slope < 0)) & ((place < high) | (slope > 0))
        direction = -np.where(free, covariance @ np.where(free, slope, 0.0), 0.0)
        if -0.5 * direction @ slope < SMALLEST_GAIN:
            break
        direction *= min(1.0, LONGEST_STEP / np.abs(direction).max())
        for _ in range(MOST_HALVINGS):
            trial = np.clip(place + direction, low, high)
            trial_value, trial_slope = objective(trial)
            if trial_value < value + 1e-4 * slope @ (trial - place) + 1e-9 * abs(value):
                break
            direction *= 0.3
        else:
            break
        step, bend = trial - place, trial_slope - slope
        if step @ bend > 1e-8 * np.linalg.norm(step) * np.linalg.norm(bend):
            left = np.eye(len(step)) - np.outer(step, bend) / (step @ bend)
            covariance = left @ covariance @ left.T + np.outer(step, step) / (step @ bend)
        place, value, slope = trial, trial_value, trial_slope
    return place, covariance, value
