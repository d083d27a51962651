"""Levenberg–Marquardt from many starts at once, for residuals of unknown variance and standard-normal coordinates.

Every iteration is a few batches of model runs: the Jacobian by differences, and trial points with several dampings
(Nocedal & Wright 2006, Numerical Optimization, ch. 10). Models whose runs are cheap in batches need no derivatives for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

DIFFERENCE = 1e-4
"""Step of the differences, in standard deviations of the prior; the forces of a polygonal law have kinks below it."""
DAMPINGS = (0.1, 1.0, 10.0)
"""Dampings that are tried in every iteration, relative to the one that succeeded last."""
LONGEST_STEP = 1.5
"""Longest step in a coordinate, in standard deviations of the prior."""
FARTHEST = 5.0
"""Largest coordinate, in standard deviations of the prior."""
KEPT = 2.0 / 3.0
"""Share of the searches that continue after every round of `ROUND` iterations."""
ROUND = 8
FEWEST = 6
"""Smallest number of searches that continue."""
BLOCK = 30_000_000
"""Largest number of residuals that are computed at once; with the Jacobian they take about a gigabyte."""

Residuals = Callable[[Float[np.ndarray, "run parameter"]], Float[np.ndarray, "run value"]]
"""Residuals, not finite for a run that failed."""


@dataclass(frozen=True)
class Minimum:
    """A minimum of n/2 log(mean square of the residuals) + ½ |x|², the negative log posterior up to a constant."""

    x: Float[np.ndarray, " parameter"]
    value: float
    mean_square: float  # of the residuals
    curvature: Float[np.ndarray, "parameter parameter"]  # JᵀJ/s² + 1


def minima_from_many_starts(
    residuals: Residuals,
    dimension: int,
    rng: np.random.Generator,
    starts: int = 24,
    iterations: int = 30,
    spread: float = 0.8,
) -> list[Minimum]:
    """Return the minima that searches from prior draws reach, the best first.

    The searches begin at the best of eight times as many draws. After some iterations only the better ones continue.
    """
    x = rng.normal(size=(8 * starts, dimension)) * spread
    best = np.argsort(_value(residuals(x), x))[:starts]
    return refined(residuals, x[best], iterations)


def refined(residuals: Residuals, x: Float[np.ndarray, "start parameter"], iterations: int) -> list[Minimum]:
    """Return the minima that searches from given points reach, the best first."""
    r = residuals(x)
    value, damping = _value(r, x), np.full(len(x), 1e-2)
    for number in range(1, iterations + 1):
        gradient, curvature = _slopes(residuals, x, r)
        trials = [_step(x, gradient, curvature, factor * damping) for factor in DAMPINGS]
        tried = residuals(np.concatenate(trials)).reshape(len(DAMPINGS), *r.shape)
        values = np.stack([_value(t, p) for t, p in zip(tried, trials, strict=True)])
        which, run = values.argmin(axis=0), np.arange(len(x))
        better = values[which, run] < value
        x = np.where(better[:, None], np.stack(trials)[which, run], x)
        r = np.where(better[:, None], tried[which, run], r)
        value = np.where(better, values[which, run], value)
        damping = np.where(better, np.maximum(damping * np.array(DAMPINGS)[which], 1e-9), 10.0 * damping)
        if number % ROUND == 0:
            kept = np.argsort(value)[: max(FEWEST, int(KEPT * len(x)))]
            x, r, value, damping = x[kept], r[kept], value[kept], damping[kept]
    _, curvature = _slopes(residuals, x, r)
    order = np.argsort(value)
    squares = np.mean(r**2, axis=1)
    return [Minimum(x[i], float(value[i]), float(squares[i]), curvature[i]) for i in order if np.isfinite(value[i])]


def _value(
    residuals: Float[np.ndarray, "run value"], x: Float[np.ndarray, "run parameter"]
) -> Float[np.ndarray, " run"]:
    """Return n/2 log s² + ½ |x|²; infinite for runs that failed."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        squares = np.mean(residuals**2, axis=1)
        value = 0.5 * residuals.shape[1] * np.log(squares) + 0.5 * (x**2).sum(axis=1)
    return np.where(np.isfinite(value), value, np.inf)


def _slopes(residuals: Residuals, x: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return gradient (start, parameter) and Gauss–Newton curvature (start, parameter, parameter) of the value."""
    count, dimension = x.shape
    gradient, curvature = np.empty((count, dimension)), np.empty((count, dimension, dimension))
    size = max(1, BLOCK // (dimension * r.shape[1]))
    for start in range(0, count, size):
        part = slice(start, start + size)
        moved = (x[part, None, :] + DIFFERENCE * np.eye(dimension)).reshape(-1, dimension)
        jacobian = (residuals(moved).reshape(-1, dimension, r.shape[1]) - r[part, None]) / DIFFERENCE
        jacobian = np.where(np.isfinite(jacobian), jacobian, 0.0)
        squares = np.mean(r[part] ** 2, axis=1)
        gradient[part] = np.einsum("idn,in->id", jacobian, r[part]) / squares[:, None] + x[part]
        curvature[part] = np.einsum("idn,ien->ide", jacobian, jacobian) / squares[:, None, None] + np.eye(dimension)
    return gradient, curvature


def _step(x: np.ndarray, gradient: np.ndarray, curvature: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Return the points after damped Gauss–Newton steps."""
    diagonal = np.einsum("idd->id", curvature)
    damped = curvature + damping[:, None, None] * diagonal[:, :, None] * np.eye(x.shape[1])
    step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
    return np.asarray(np.clip(x + np.clip(step, -LONGEST_STEP, LONGEST_STEP), -FARTHEST, FARTHEST))
