"""A function of the parameters of many runs with its derivatives along each of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp


def with_slopes(function: Callable[[Any], Any], parameters: Float[Array, "run parameter"]) -> tuple[Any, Any]:
    """Call a function of the parameters of many runs, and differentiate it along each of them; the value is computed once.

    Forward, since parameters are few and histories long.
    """

    def along(direction: Any) -> tuple[Any, Any]:
        found: tuple[Any, Any] = jax.jvp(function, (parameters,), (jnp.broadcast_to(direction, parameters.shape),))
        return found

    found: tuple[Any, Any] = jax.vmap(along, out_axes=(None, 0))(jnp.eye(parameters.shape[1]))
    return found
