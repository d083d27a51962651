"""Levenberg–Marquardt from many starts at once, for residuals of unknown variances and standard-normal coordinates.

Every iteration is a few batches of model runs: the Jacobian by differences, and trial points with several dampings
(Nocedal & Wright 2006, Numerical Optimization, ch. 10). Models whose runs are cheap in batches need no derivatives for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int

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
GAIN, PATIENCE = 0.01, 3
"""Gain of an iteration below which a search is idle; a search ends after some idle iterations."""
SAME, MOST_MINIMA = 0.05, 8
"""Distance of two minima in every coordinate, in standard deviations of the prior, below which they are one; most minima."""
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

    The searches begin at the best of eight times as many draws. A search ends where it no longer gains. After some iterations only
    the better ones of the others continue, or none if all values are above `give_up`.
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
    active = _Searches(x, r, _value(r, x, blocks), np.full(len(x), 1e-2), np.zeros(len(x), dtype=int))
    ended: list[_Searches] = []
    for number in range(1, iterations + 1):
        active = _moved(residuals, active, blocks)
        ended.append(active.of(active.idle >= PATIENCE))
        active = active.of(active.idle < PATIENCE)
        if not len(active.x):
            break
        if number % ROUND == 0:
            if min(searches.value.min(initial=np.inf) for searches in (active, *ended)) > give_up:
                break
            active = active.of(np.argsort(active.value)[: max(FEWEST, int(KEPT * len(active.x)))])
    return _minima(residuals, _Searches.joined([*ended, active]), blocks)


@dataclass(frozen=True, eq=False)
class _Searches:
    """Searches that go on at the same time."""

    x: Float[np.ndarray, "search parameter"]
    r: Float[np.ndarray, "search value"]  # residuals
    value: Float[np.ndarray, " search"]
    damping: Float[np.ndarray, " search"]
    idle: Int[np.ndarray, " search"]  # iterations without a gain

    def of(self, rows: np.ndarray) -> _Searches:
        """Return some of the searches."""
        return _Searches(*(getattr(self, f.name)[rows] for f in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[_Searches]) -> _Searches:
        """Return all searches of some groups."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))


def _moved(residuals: Residuals, now: _Searches, blocks: Blocks) -> _Searches:
    """Move every search to the best of its trial points, if that is better."""
    gradient, curvature = _slopes(residuals, now.x, now.r, blocks)
    trials = np.stack([_step(now.x, gradient, curvature, factor * now.damping) for factor in DAMPINGS])
    tried = residuals(trials.reshape(-1, trials.shape[2])).reshape(len(DAMPINGS), *now.r.shape)
    values = np.stack([_value(t, p, blocks) for t, p in zip(tried, trials, strict=True)])
    which, run = values.argmin(axis=0), np.arange(len(now.x))
    value, better = values[which, run], values[which, run] < now.value
    lower = np.maximum(now.damping * np.array(DAMPINGS)[which], 1e-9)
    return _Searches(
        np.where(better[:, None], trials[which, run], now.x),
        np.where(better[:, None], tried[which, run], now.r),
        np.where(better, value, now.value),
        np.where(better, lower, 10.0 * now.damping),
        np.where(value < now.value - GAIN, 0, now.idle + 1),
    )


def _minima(residuals: Residuals, searches: _Searches, blocks: Blocks) -> list[Minimum]:
    """Return the different minima of searches, the best first."""
    rows: list[int] = []
    for row in np.argsort(searches.value):
        apart = all(np.abs(searches.x[row] - searches.x[other]).max() > SAME for other in rows)
        if np.isfinite(searches.value[row]) and apart and len(rows) < MOST_MINIMA:
            rows.append(int(row))
    if not rows:
        return []
    found = searches.of(np.array(rows))
    _, curvature = _slopes(residuals, found.x, found.r, blocks)
    each = zip(found.x, found.value, _mean_squares(found.r, blocks), curvature, strict=True)
    return [Minimum(x, float(value), squares, curved) for x, value, squares, curved in each]


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
