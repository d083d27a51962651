"""Cycles of a loop: a few that stand for all, from early to late, so that loops can be told apart."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float

MOST = 4
"""Cycles that stand for a history."""
LARGE = 0.3
"""Share of the largest amplitude from which a cycle is one of those chosen from."""


def cycles(displacement: Float[np.ndarray, " time"]) -> list[slice]:
    """Cut a history into cycles, each from one crossing of zero upwards to the next."""
    crossings = np.flatnonzero((displacement[:-1] < 0.0) & (displacement[1:] >= 0.0)) + 1
    return [slice(int(first), int(last) + 1) for first, last in itertools.pairwise(crossings)]


def chosen_cycles(displacement: Float[np.ndarray, " time"], most: int = MOST) -> list[slice]:
    """Choose the largest cycle of each of some parts of a history, from early to late."""
    found = cycles(displacement)
    sizes = np.array([np.ptp(displacement[cycle]) for cycle in found])
    large = np.flatnonzero(sizes >= LARGE * sizes.max(initial=0.0))
    parts = [part for part in np.array_split(large, most) if len(part)]
    return [found[part[np.argmax(sizes[part])]] for part in parts]
