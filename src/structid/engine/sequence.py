"""A few steps one after the other, outside JAX or inside it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax import lax


def in_sequence(step: Callable[[Any, Any], tuple[Any, Any]], start: Any, rows: tuple[Any, ...]) -> tuple[Any, Any]:
    """Take a step for every row.

    Parameters
    ----------
    step : callable
        ``step(carried, row) -> (carried, seen)``.
    start : tree of arrays
        What is carried into the first step. NumPy arrays are stepped by Python, in which a step may move a machine.
    rows : tuple of arrays, each of shape (step, …)
        What each step takes.

    Returns
    -------
    tuple of tree of arrays
        What is carried out of the last step, and what was seen, with the steps first.
    """
    if not all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(start)):
        found: tuple[Any, Any] = lax.scan(step, start, rows)
        return found
    carried, seen = start, []
    for row in zip(*rows, strict=True):
        carried, sight = step(carried, row)
        seen.append(sight)
    return carried, jax.tree.map(lambda *x: np.stack(x), *seen)
