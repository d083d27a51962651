"""A density and its gradient in compiled vector code, for samplers inside JAX."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax

from structid.engine.lanes.in_lanes import InLanes
from structid.engine.slopes import with_slopes


def differentiable_in_lanes(
    density: Callable[..., Any], parameters: int, constants: tuple[Any, ...]
) -> Callable[[Any], Any] | None:
    """Compile a density and its gradient to vector code where this is possible.

    Derivatives are propagated forward along all parameters at once, since parameters are few and histories long. Terms common
    to all directions, such as the matrix of a linear system, are computed once.
    """

    def with_gradient(phi: Any, *constants: Any) -> tuple[Any, Any]:
        value, slopes = with_slopes(lambda at: density(at, *constants), phi)
        return value, slopes.T

    compiled = InLanes(with_gradient).compiled(parameters, constants)
    if compiled is None:
        return None

    def slope(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
        value, gradient = compiled.inside_jax(*primals)
        return value, (gradient * tangents[0]).sum(axis=1)

    result: Any = jax.custom_jvp(lambda phi: compiled.inside_jax(phi)[0])
    result.defjvp(slope)
    differentiable: Callable[[Any], Any] = result
    return differentiable
