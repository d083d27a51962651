"""Levenberg–Marquardt from many starts at once, for residuals of unknown variances and standard-normal coordinates.

Every iteration is a few batches of model runs: the Jacobian by differences, and trial points with several dampings
(Nocedal & Wright 2006, Numerical Optimization, ch. 10). Models whose runs are cheap in batches need no derivatives for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

Blocks = Sequence[slice]
"""Residuals that share a variance, such as those of one sensor; together they are all residuals."""

ALL: Blocks = (slice(None),)


@dataclass(frozen=True)
class Minimum:
    """A minimum of Σ_b n_b/2 log s_b² + ½ |x|², the negative log posterior up to a constant; s_b² is the mean square of a block."""

    x: Float[np.ndarray, " parameter"]
    value: float
    mean_squares: Float[np.ndarray, " block"]  # of the residuals
    curvature: Float[np.ndarray, "parameter parameter"]  # Σ_b JᵀJ/s_b² + 1


def minima_from_many_starts(
    residuals: Residuals,
    dimension: int,
    rng: np.random.Generator,
    starts: int = 24,
    iterations: int = 30,
    spread: float = 0.8,
    blocks: Blocks = ALL,
    give_up: float = np.inf,
) -> list[Minimum]:
    """Return the minima that searches from prior draws reach, the best first.

    The searches begin at the best of eight times as many draws. After some iterations only the better ones continue, or none if
    all values are above `give_up`.
    """
    x = rng.normal(size=(8 * starts, dimension)) * spread
    best = np.argsort(_value(residuals(x), x, blocks))[:starts]
    return refined(residuals, x[best], iterations, blocks, give_up)


def refined(
    residuals: Residuals,
    x: Float[np.ndarray, "start parameter"],
    iterations: int,
    blocks: Blocks = ALL,
    give_up: float = np.inf,
) -> list[Minimum]:
    """Return the minima that searches from given points reach, the best first."""
    r = residuals(x)
    value, damping = _value(r, x, blocks), np.full(len(x), 1e-2)
    for number in range(1, iterations + 1):
        gradient, curvature = _slopes(residuals, x, r, blocks)
        trials = [_step(x, gradient, curvature, factor * damping) for factor in DAMPINGS]
        tried = residuals(np.concatenate(trials)).reshape(len(DAMPINGS), *r.shape)
        values = np.stack([_value(t, p, blocks) for t, p in zip(tried, trials, strict=True)])
        which, run = values.argmin(axis=0), np.arange(len(x))
        better = values[which, run] < value
        x = np.where(better[:, None], np.stack(trials)[which, run], x)
        r = np.where(better[:, None], tried[which, run], r)
        value = np.where(better, values[which, run], value)
        damping = np.where(better, np.maximum(damping * np.array(DAMPINGS)[which], 1e-9), 10.0 * damping)
        if number % ROUND == 0:
            if value.min() > give_up:
                break
            kept = np.argsort(value)[: max(FEWEST, int(KEPT * len(x)))]
            x, r, value, damping = x[kept], r[kept], value[kept], damping[kept]
    _, curvature = _slopes(residuals, x, r, blocks)
    order = np.argsort(value)
    squares = _mean_squares(r, blocks)
    return [Minimum(x[i], float(value[i]), squares[i], curvature[i]) for i in order if np.isfinite(value[i])]


def _mean_squares(residuals: Float[np.ndarray, "run value"], blocks: Blocks) -> Float[np.ndarray, "run block"]:
    return np.stack([np.mean(residuals[:, block] ** 2, axis=1) for block in blocks], axis=1)


def _value(
    residuals: Float[np.ndarray, "run value"], x: Float[np.ndarray, "run parameter"], blocks: Blocks
) -> Float[np.ndarray, " run"]:
    """Return Σ_b n_b/2 log s_b² + ½ |x|²; infinite for runs that failed."""
    counts = np.array([residuals[0, block].size for block in blocks])
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        value = 0.5 * np.log(_mean_squares(residuals, blocks)) @ counts + 0.5 * (x**2).sum(axis=1)
    return np.where(np.isfinite(value), value, np.inf)


def _slopes(residuals: Residuals, x: np.ndarray, r: np.ndarray, blocks: Blocks) -> tuple[np.ndarray, np.ndarray]:
    """Return gradient (start, parameter) and Gauss–Newton curvature (start, parameter, parameter) of the value."""
    count, dimension = x.shape
    gradient, curvature = np.empty((count, dimension)), np.empty((count, dimension, dimension))
    size = max(1, BLOCK // (dimension * r.shape[1]))
    for start in range(0, count, size):
        part = slice(start, start + size)
        moved = (x[part, None, :] + DIFFERENCE * np.eye(dimension)).reshape(-1, dimension)
        jacobian = (residuals(moved).reshape(-1, dimension, r.shape[1]) - r[part, None]) / DIFFERENCE
        jacobian = np.where(np.isfinite(jacobian), jacobian, 0.0)
        squares = _mean_squares(r[part], blocks)
        gradient[part], curvature[part] = x[part], np.eye(dimension)
        for number, block in enumerate(blocks):
            slopes, variance = jacobian[:, :, block], squares[:, number]
            gradient[part] += np.einsum("idn,in->id", slopes, r[part, block]) / variance[:, None]
            curvature[part] += np.einsum("idn,ien->ide", slopes, slopes) / variance[:, None, None]
    return gradient, curvature


def _step(x: np.ndarray, gradient: np.ndarray, curvature: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Return the points after damped Gauss–Newton steps."""
    diagonal = np.einsum("idd->id", curvature)
    damped = curvature + damping[:, None, None] * diagonal[:, :, None] * np.eye(x.shape[1])
    step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
    return np.asarray(np.clip(x + np.clip(step, -LONGEST_STEP, LONGEST_STEP), -FARTHEST, FARTHEST))
