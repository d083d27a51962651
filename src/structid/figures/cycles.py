"""Representative cycles of a loop, from early to late, so that loops can be distinguished."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float

MOST = 4
"""Number of representative cycles."""
LARGE = 0.3
"""Fraction of the largest amplitude above which a cycle may be chosen."""


def cycles(displacement: Float[np.ndarray, " time"]) -> list[slice]:
    """Split a history into cycles between upward zero crossings."""
    crossings = np.flatnonzero((displacement[:-1] < 0.0) & (displacement[1:] >= 0.0)) + 1
    return [slice(int(first), int(last) + 1) for first, last in itertools.pairwise(crossings)]


def chosen_cycles(displacement: Float[np.ndarray, " time"], most: int = MOST) -> list[slice]:
    """Choose the largest cycle of each of several parts of a history, from early to late."""
    all_cycles = cycles(displacement)
    sizes = np.array([np.ptp(displacement[cycle]) for cycle in all_cycles])
    large = np.flatnonzero(sizes >= LARGE * sizes.max(initial=0.0))
    parts = [part for part in np.array_split(large, most) if len(part)]
    return [all_cycles[part[np.argmax(sizes[part])]] for part in parts]
