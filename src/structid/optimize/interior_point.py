"""Primal-dual interior-point method, Gauss-Newton curvature (Nocedal & Wright 2006, Numerical Optimization, ch. 19)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from structid.core.validation import check_arguments
from structid.optimize.minima import OptimizeResult, collect
from structid.optimize.region import Objective, Region, region, starting_points

TO_BOUNDARY = 0.995
"""Largest fraction of the distance to the boundary that a step may take."""
STEP_LENGTHS = 0.5 ** np.arange(12)
"""Step lengths tried along every direction, in one batch."""
SMALLEST_BARRIER = 1e-30
"""Final barrier parameter; nearly zero, because a minimum on a face is reached only as the barrier vanishes."""
SMALLEST_SLACK = 1e-16
"""Lower limit of a slack: rounding of the coordinates makes a smaller distance to a face meaningless."""


@dataclass
class _Iterate:
    """State of the search from one start."""

    x: np.ndarray
    multipliers: np.ndarray
    barrier: float
    damping: float = 1e-3
    value: float = np.inf
    gradient: np.ndarray | None = None
    curvature: np.ndarray | None = None
    stalled: int = 0
    finished: bool = False


@check_arguments
def interior_point(
    objective: Objective,
    bounds: dict[str, tuple[float, float]] | None = None,
    constraints: Sequence[str] = (),
    starts: int | np.ndarray = 20,
    seed: int = 1,
    tolerance: float = 1e-15,
    iterations: int = 200,
    progress: Any = None,
) -> OptimizeResult:
    """Minimise with exact gradients by an interior-point method, whose barrier vanishes in the limit.

    ::

        minimise  J(x)/scale − μ Σ log s_i,   s = b − A x > 0,   μ → 0
        (H + Aᵀ diag(λ/s) A + δ I) Δx = −(∇J/scale + Aᵀ (μ/s)),   Δλ = (μ + λ (AΔx))/s − λ

    with H = 2 JᵀJ and J the exact Jacobian of the residuals (automatic differentiation through the integrator).

    Parameters
    ----------
    objective : Objective
        The function to minimise, such as `Posterior.misfit`; it must have derivatives.
    bounds : dict of str to pair of float, optional
        Bounds in SI, used instead of the support of the prior.
    constraints : sequence of str
        Linear inequalities in SI, such as ``"gamma <= beta"``.
    starts : int or ndarray, shape (start, parameter)
        Number of starting points to draw, or the points in SI.
    seed : int
        Seed of the starting points.
    tolerance : float
        A search ends when J/scale changes by less than this and the barrier has vanished.
    iterations : int
        Largest number of steps for each start.
    progress : callable, optional
        Called with the number of finished starts and the total.

    Returns
    -------
    OptimizeResult
        Distinct minima, best first.
    """
    where = region(objective, bounds, constraints)
    x = np.clip(starting_points(where, starts, seed), 1e-9, 1.0 - 1e-9)
    iterates = [_Iterate(p, np.full(len(where.limit), 1e-2), 1e-2) for p in x]
    evaluations = 0
    for _ in range(iterations):
        active = [it for it in iterates if not it.finished]
        if not active:
            break
        evaluations += _linearise(objective, where, active)
        steps = [_direction(it, where) for it in active]
        trials = np.concatenate([it.x + STEP_LENGTHS[:, None] * s[0] for it, s in zip(active, steps, strict=True)])
        values = objective(where.to_theta(trials)) / objective.scale
        evaluations += len(trials)
        for it, (dx, dual), result in zip(active, steps, values.reshape(len(active), -1), strict=True):
            _advance(it, where, dx, dual, result, tolerance)
        if progress is not None:
            progress(sum(it.finished for it in iterates), len(iterates))
    ends = np.array([it.x for it in iterates])
    final = objective(where.to_theta(ends))
    return collect("interior point", objective, where, ends, final, evaluations + len(ends))


def _linearise(objective: Objective, where: Region, iterates: list[_Iterate]) -> int:
    value, gradient, curvature = objective.linearised(where.to_theta(np.array([it.x for it in iterates])))
    for it, v, g, h in zip(iterates, value, gradient, curvature, strict=True):
        it.value = float(v) / objective.scale
        it.gradient = g * where.width / objective.scale
        it.curvature = where.width[:, None] * h * where.width[None, :] / objective.scale
        it.finished = not np.isfinite(it.value + it.gradient.sum() + it.curvature.sum())
        if it.finished:
            it.gradient, it.curvature = np.zeros_like(it.x), np.eye(it.x.size)
    return len(iterates) * (1 + where.width.size)


def _slack(where: Region, x: np.ndarray) -> np.ndarray:
    slack: np.ndarray = np.maximum(where.slack(x), SMALLEST_SLACK)
    return slack


def _direction(it: _Iterate, where: Region) -> tuple[np.ndarray, np.ndarray]:
    """Primal-dual direction, shortened so that it stays inside the boundary."""
    assert it.gradient is not None and it.curvature is not None
    slack = _slack(where, it.x)
    barrier_curvature = where.matrix.T @ ((it.multipliers / slack)[:, None] * where.matrix)
    system = it.curvature + barrier_curvature
    system = system + it.damping * np.diag(np.maximum(np.diag(it.curvature), 1e-12 * np.trace(it.curvature)))
    right = -(it.gradient + where.matrix.T @ (it.barrier / slack))
    # Scaling by the diagonal avoids a loss of digits where a slack is tiny.
    root = 1.0 / np.sqrt(np.diag(system))
    dx = root * np.linalg.lstsq(system * root[:, None] * root[None, :], right * root, rcond=1e-15)[0]
    dual = (it.barrier + it.multipliers * (where.matrix @ dx)) / slack - it.multipliers
    return dx * min(1.0, TO_BOUNDARY * where.longest_step(it.x, dx)), dual


def _advance(
    it: _Iterate, where: Region, dx: np.ndarray, dual: np.ndarray, found: np.ndarray, tolerance: float
) -> None:
    """Take the step length with the smallest barrier function; adapt damping and barrier."""
    trials = it.x + STEP_LENGTHS[:, None] * dx
    merit = found - it.barrier * np.log(_slack(where, trials)).sum(axis=1)
    here = it.value - it.barrier * np.log(_slack(where, it.x)).sum()
    best = int(np.argmin(np.where(np.isfinite(merit), merit, np.inf)))
    if not merit[best] < here:
        it.stalled += 1
        it.damping = min(max(it.damping, 1e-12) * 10.0, 1e6)
        if it.stalled > 6:
            it.finished = it.barrier <= SMALLEST_BARRIER
            it.barrier, it.stalled, it.damping = max(it.barrier * 1e-3, SMALLEST_BARRIER), 0, 1e-8
        return
    gain = here - merit[best]
    it.x, it.stalled = trials[best], 0
    it.damping = it.damping * (0.1 if best == 0 else 1.0 if best < 4 else 4.0)
    shrinking = dual < 0
    longest = min(1.0, TO_BOUNDARY * (it.multipliers[shrinking] / -dual[shrinking]).min()) if shrinking.any() else 1.0
    it.multipliers = it.multipliers + longest * dual
    # Keep the multipliers near the central path, so that a poor start does not stay stuck at a face.
    slack = _slack(where, it.x)
    it.multipliers = np.clip(it.multipliers, it.barrier / slack * 1e-8, it.barrier / slack * 1e8)
    if gain < 0.1 * max(it.barrier, tolerance * 1e-3) + 1e-3 * found[best]:
        it.finished = it.barrier <= SMALLEST_BARRIER and gain <= tolerance * max(found[best], tolerance)
        it.barrier = max(it.barrier * 0.1, SMALLEST_BARRIER)
