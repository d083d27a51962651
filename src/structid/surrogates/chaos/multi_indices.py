"""Multi-indices: the degree of each parameter in each term of a truncated polynomial basis.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Int

from structid.core.errors import InputError

LARGEST_BASIS = 200_000
"""Largest number of terms; a larger basis is refused as a probable mistake."""


def multi_indices(
    dimension: int, degree: int, hyperbolic_norm: float = 1.0, interaction: int | None = None
) -> Int[np.ndarray, "term parameter"]:
    """Return the multi-indices α with ‖α‖_q ≤ p and at most r non-zero entries (thesis eqs. 2.37, 2.38)."""
    if not (0 < hyperbolic_norm <= 1):
        raise InputError("hyperbolic_norm", f"{hyperbolic_norm}", "a number in (0, 1]")
    if degree < 0 or int(degree) != degree:
        raise InputError("degree", f"{degree}", "a whole number of 0 or more")
    order = dimension if interaction is None else min(interaction, dimension)
    budget = degree**hyperbolic_norm * (1 + 1e-12)
    kept = [np.zeros((1, dimension), dtype=int)]
    for count in range(1, order + 1):
        degrees = _degrees_within(count, degree, hyperbolic_norm, budget)
        if len(degrees) == 0:
            break
        for places in itertools.combinations(range(dimension), count):
            block = np.zeros((len(degrees), dimension), dtype=int)
            block[:, places] = degrees
            kept.append(block)
        if sum(map(len, kept)) > LARGEST_BASIS:
            raise InputError(
                "degree",
                f"degree {degree} in {dimension} parameters gives more than {LARGEST_BASIS} terms",
                "a smaller basis",
                "Lower the degree, hyperbolic_norm or interaction.",
            )
    indices = np.concatenate(kept)
    return np.asarray(indices[by_degree(indices)])


def by_degree(indices: Int[np.ndarray, "term parameter"]) -> Int[np.ndarray, " term"]:
    """Return the order of multi-indices by total degree; within a degree, the first parameters come first."""
    return np.lexsort((*(-indices.T[::-1]), indices.sum(axis=1)))


def _degrees_within(count: int, degree: int, q: float, budget: float) -> np.ndarray:
    """Return all tuples of `count` positive degrees with Σ αᵢ^q ≤ budget, shape (n, count)."""
    rows = np.zeros((1, 0), dtype=int)
    for _ in range(count):
        repeated = np.repeat(rows, degree, axis=0)
        added = np.tile(np.arange(1, degree + 1), len(rows))[:, None]
        rows = np.hstack([repeated, added])
        rows = rows[np.sum(rows.astype(float) ** q, axis=1) <= budget]
    return rows
