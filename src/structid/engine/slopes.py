"""Derivatives of a function of the parameters of many runs with respect to each parameter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp


def with_slopes(function: Callable[[Any], Any], parameters: Float[Array, "run parameter"]) -> tuple[Any, Any]:
    """Evaluate a function of the parameters of many runs and its derivatives; the value is computed only once.

    Differentiation is in forward mode, since parameters are few and histories long.
    """

    def along(direction: Any) -> tuple[Any, Any]:
        result: tuple[Any, Any] = jax.jvp(function, (parameters,), (jnp.broadcast_to(direction, parameters.shape),))
        return result

    result: tuple[Any, Any] = jax.vmap(along, out_axes=(None, 0))(jnp.eye(parameters.shape[1]))
    return result
