"""Choice of the array module: NumPy outside JAX, ``jax.numpy`` inside it."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.engine.device import jnp


def namespace(x: Any) -> Any:
    """Return the module whose functions apply to an array: NumPy or ``jax.numpy``."""
    return np if isinstance(x, (np.ndarray, np.generic, float, int)) else jnp
