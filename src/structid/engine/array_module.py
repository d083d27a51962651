"""The array module of an array: NumPy outside JAX, ``jax.numpy`` inside it."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.engine.device import jnp


def namespace(x: Any) -> Any:
    """Return the array module for an array."""
    return np if isinstance(x, (np.ndarray, np.generic, float, int)) else jnp
