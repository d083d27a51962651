"""Calls of compiled functions in batches of runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

LARGEST_BATCH = 2000
"""Largest number of runs in one call; the memory must hold all of them at once."""


def in_batches(
    function: Callable[..., Any], rows: Float[np.ndarray, "run ..."], data: Any, size: int = LARGEST_BATCH
) -> tuple[np.ndarray, ...]:
    """Call a compiled function of many runs in batches, and join the results."""
    parts = [function(rows[start : start + size], data) for start in range(0, len(rows), size)]
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))
