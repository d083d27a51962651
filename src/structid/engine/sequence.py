"""A short loop over rows that runs outside or inside JAX."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax import lax


def in_sequence(step: Callable[[Any, Any], tuple[Any, Any]], start: Any, rows: tuple[Any, ...]) -> tuple[Any, Any]:
    """Apply `step` to each row in turn, like `jax.lax.scan`; return the last state and the stacked outputs."""
    if not all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(start)):
        result: tuple[Any, Any] = lax.scan(step, start, rows)
        return result
    carried, outputs = start, []
    for row in zip(*rows, strict=True):
        carried, sight = step(carried, row)
        outputs.append(sight)
    return carried, jax.tree.map(lambda *x: np.stack(x), *outputs)
