"""Representative cycles of a hysteresis loop, from early to late."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float

MOST = 4
"""Number of representative cycles."""
LARGE = 0.3
"""Minimum amplitude of a representative cycle, as a fraction of the largest amplitude."""


def cycles(displacement: Float[np.ndarray, " time"]) -> list[slice]:
    """Split a history into cycles between upward zero crossings."""
    crossings = np.flatnonzero((displacement[:-1] < 0.0) & (displacement[1:] >= 0.0)) + 1
    return [slice(int(first), int(last) + 1) for first, last in itertools.pairwise(crossings)]


def chosen_cycles(displacement: Float[np.ndarray, " time"], most: int = MOST) -> list[slice]:
    """Split a history into several parts and choose the largest cycle of each part, from early to late."""
    all_cycles = cycles(displacement)
    sizes = np.array([np.ptp(displacement[cycle]) for cycle in all_cycles])
    large = np.flatnonzero(sizes >= LARGE * sizes.max(initial=0.0))
    parts = [part for part in np.array_split(large, most) if len(part)]
    return [all_cycles[part[np.argmax(sizes[part])]] for part in parts]
