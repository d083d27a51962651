"""Designs of experiments on the unit cube: random, Latin hypercube (plain and maximin), scrambled Sobol'."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import scipy

from structid.errors import InputError, check_choice
from structid.streams import Purpose, stream

METHODS = {
    "latin_hypercube": Purpose.LATIN_HYPERCUBE,
    "maximin": Purpose.MAXIMIN,
    "sobol": Purpose.SOBOL,
    "random": Purpose.RANDOM_DESIGN,
}
"""Names of the methods, and the random stream of each."""


def unit_design(count: int, dimension: int, seed: int, method: str) -> np.ndarray:
    """Design of experiments in the unit cube.

    Parameters
    ----------
    count, dimension : int
        Number of points and of coordinates.
    seed : int
        Seed.
    method : {"latin_hypercube", "maximin", "sobol", "random"}
        How to place the points.

    Returns
    -------
    ndarray, shape (count, dimension)
        Points strictly inside the cube.
    """
    check_choice("sample: method", method, METHODS)
    if count < 1:
        raise InputError("sample: count", f"{count}", "1 or more")
    rng = stream(seed, METHODS[method])
    if method == "random":
        points = rng.random((count, dimension))
    elif method == "sobol":
        # Draw up to the next power of two, where the sequence is balanced, and keep the first points.
        power = int(np.ceil(np.log2(max(count, 2))))
        points = scipy.stats.qmc.Sobol(dimension, scramble=True, **_generator(rng)).random_base2(power)[:count]
    else:
        points = scipy.stats.qmc.LatinHypercube(dimension, **_generator(rng)).random(count)
        if method == "maximin" and count > 2:
            points = _maximin(points, rng)
    return np.clip(points, 1e-12, 1.0 - 1e-12)


def _generator(rng: np.random.Generator) -> dict[str, Any]:
    # SciPy 1.15 renamed the argument from seed to rng.
    return {"rng" if "rng" in inspect.signature(scipy.stats.qmc.LatinHypercube.__init__).parameters else "seed": rng}


def smallest_distance(points: np.ndarray) -> float:
    """Smallest distance between two points of a design.

    Parameters
    ----------
    points : ndarray, shape (point, coordinate)
        The design.

    Returns
    -------
    float
        The distance.
    """
    return float(scipy.spatial.cKDTree(points).query(points, k=2)[0][:, 1].min())


def _maximin(points: np.ndarray, rng: np.random.Generator, sweeps: int = 300) -> np.ndarray:
    """Increase the smallest distance between points of a Latin hypercube by exchanging coordinates of the closest pair."""
    best = smallest_distance(points)
    for _ in range(sweeps):
        distance = scipy.spatial.cKDTree(points).query(points, k=2)[0][:, 1]
        row, column = int(np.argmin(distance)), int(rng.integers(points.shape[1]))
        other = int(rng.integers(points.shape[0]))
        trial = points.copy()
        trial[[row, other], column] = trial[[other, row], column]
        candidate = smallest_distance(trial)
        if candidate > best:
            points, best = trial, candidate
    return points
