"""Generating-set pattern search under linear constraints (Kolda, Lewis & Torczon 2003, SIAM Review 45, 385)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from structid.core.validation import check_arguments
from structid.optimize.minima import OptimizeResult, collect
from structid.optimize.region import Objective, Region, region, starting_points

EXPANSION, CONTRACTION = 2.0, 0.5
"""Factors on the step length after a successful and after a failed poll."""
CURVATURE_EVERY = 8
"""Number of iterations between updates of the curvature that whitens the poll directions."""


@dataclass
class _Search:
    """State of the search from one start."""

    x: np.ndarray
    value: float
    step: float
    whitening: np.ndarray
    iteration: int = 0
    finished: bool = False
    polls: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    lengths: np.ndarray = field(default_factory=lambda: np.empty(0))


@check_arguments
def pattern_search(
    objective: Objective,
    bounds: dict[str, tuple[float, float]] | None = None,
    constraints: Sequence[str] = (),
    starts: int | np.ndarray = 20,
    seed: int = 1,
    whiten: bool | None = None,
    tolerance: float = 1e-9,
    iterations: int = 2000,
    progress: Any = None,
) -> OptimizeResult:
    """Minimise by polling along a set of directions that spans the feasible cone.

    At every iteration each start polls along d directions in both senses and, near a face, along directions within the face and
    away from it. If a poll improves the objective, the best poll is taken and the step is doubled; otherwise the step is halved.
    Steps are cut at the boundary, so every poll is feasible. All starts poll in one batch.

    The misfit of a hysteretic model is so ill-conditioned (scaled condition number 7e5 in the benchmark study) that polls along
    the coordinates stall. The directions are therefore whitened by the Gauss-Newton curvature H of the objective,
    d = H^(−1/2) e, in the whole space and within the active faces.

    Parameters
    ----------
    objective : Objective
        The function to minimise, such as `Posterior.misfit`.
    bounds : dict of str to pair of float, optional
        Bounds in SI, used instead of the support of the prior.
    constraints : sequence of str
        Linear inequalities in SI, such as ``"gamma <= beta"``.
    starts : int or ndarray, shape (start, parameter)
        Number of starting points to draw, or the points in SI.
    seed : int
        Seed of the starting points.
    whiten : bool, optional
        Whiten by the curvature, which needs an objective with derivatives. The default is True for such an objective.
        False polls along the coordinates.
    tolerance : float
        Step, as a fraction of the range between bounds, at which a search ends.
    iterations : int
        Largest number of iterations.
    progress : callable, optional
        Called with the number of finished starts and the total.

    Returns
    -------
    OptimizeResult
        Distinct minima, best first.
    """
    whiten = objective.differentiable if whiten is None else whiten
    where = region(objective, bounds, constraints)
    x = starting_points(where, starts, seed)
    dimension = x.shape[1]
    values = objective(where.to_theta(x))
    evaluations = len(x)
    searches = [_Search(p, float(v), 0.1, np.eye(dimension)) for p, v in zip(x, values, strict=True)]
    for iteration in range(iterations):
        active = [s for s in searches if not s.finished]
        if not active:
            break
        if whiten and iteration % CURVATURE_EVERY == 0:
            evaluations += _update_whitening(objective, where, active)
        for search in active:
            search.polls, search.lengths = _polls(search, where)
        counts = [len(s.polls) for s in active]
        polled = objective(where.to_theta(np.concatenate([s.polls for s in active])))
        evaluations += len(polled)
        for search, result in zip(active, np.split(polled, np.cumsum(counts)[:-1]), strict=True):
            _decide(search, result, tolerance)
        if progress is not None:
            progress(sum(s.finished for s in searches), len(searches))
    ends = np.array([s.x for s in searches])
    return collect("pattern search", objective, where, ends, np.array([s.value for s in searches]), evaluations)


def _decide(search: _Search, found: np.ndarray, tolerance: float) -> None:
    search.iteration += 1
    found = np.where(np.isnan(found), np.inf, found)
    best = int(np.argmin(found)) if found.size else -1
    if best >= 0 and found[best] < search.value:
        search.x, search.value = search.polls[best], float(found[best])
        # The new step comes from the length of the poll, which a face may have cut. Otherwise, ever smaller gains keep it large.
        search.step = min(search.lengths[best] * EXPANSION, 1.0)
    else:
        search.step *= CONTRACTION
        search.finished = search.step < tolerance


def _update_whitening(objective: Objective, where: Region, searches: list[_Search]) -> int:
    """Set the whitening of every search to H^(−1/2) at its point; return the number of model runs."""
    _, _, hessian = objective.linearised(where.to_theta(np.array([s.x for s in searches])))
    for search, curvature in zip(searches, hessian, strict=True):
        scaled = where.width[:, None] * curvature * where.width[None, :]
        if np.isfinite(scaled).all() and np.abs(scaled).max() > 0:
            search.whitening = _inverse_root(scaled)
    return len(searches) * (1 + where.width.size)


def _inverse_root(curvature: np.ndarray) -> np.ndarray:
    """H^(−1/2) with its longest column scaled to length one; a unit step changes the quadratic model equally in each column."""
    eigenvalues, vectors = scipy.linalg.eigh(curvature)
    eigenvalues = np.maximum(eigenvalues, 1e-14 * eigenvalues[-1])
    root: np.ndarray = vectors * np.sqrt(eigenvalues[0] / eigenvalues)
    return root


def _polls(search: _Search, where: Region) -> tuple[np.ndarray, np.ndarray]:
    """Feasible trial points of one search, and the lengths of the steps to them."""
    directions = [search.whitening.T]
    near = where.slack(search.x) < max(search.step, 1e-12)
    if near.any():
        directions.append(_within_faces(search.whitening, where.matrix[near]))
        directions.append(-where.matrix[near])
    both = np.concatenate(directions)
    both = np.concatenate([both, -both])
    lengths = np.array([min(search.step, where.longest_step(search.x, direction)) for direction in both])
    far = lengths > 1e-3 * search.step
    return search.x + lengths[far, None] * both[far], lengths[far]


def _within_faces(whitening: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Whitened directions within the nearby faces, which have A d = 0."""
    tangent = scipy.linalg.null_space(normals)
    if tangent.shape[1] == 0:
        return np.empty((0, whitening.shape[0]))
    # H = W^(−T) W^(−1) up to scale; its restriction to the face is Tᵀ H T.
    inverse = np.linalg.inv(whitening)
    reduced = tangent.T @ inverse.T @ inverse @ tangent
    directions: np.ndarray = (tangent @ _inverse_root(0.5 * (reduced + reduced.T))).T
    return directions
