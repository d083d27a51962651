"""A loop over the samples of a record. It returns histories, or reduces them to a few sums during the loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.engine.slopes import with_slopes

State = Any
"""A JAX tree (nested containers) of arrays whose last axis is the run axis."""


class Fold(NamedTuple):
    """A sample-by-sample reduction of a history, such as a sum; the history itself need not be stored."""

    start: Any  # sums before the first sample
    step: Callable[[Any, Any], Any]  # ``step(sums, sample) -> sums``
    value: Callable[[Any], Any]  # ``value(sums)``: the final result

    def of(self, series: Any) -> Any:
        """Reduce an existing history."""
        sums, _ = lax.scan(lambda sums, sample: (self.step(sums, sample), None), self.start, series)
        return self.value(sums)


def sum_of_squares(nothing: Any) -> Fold:
    """Return a fold that computes Σ x²."""
    return Fold(nothing, lambda sums, sample: sums + sample**2, lambda sums: sums)


def side_by_side(folds: Sequence[Fold]) -> Fold:
    """Combine several folds, each of its own history, into one."""
    return Fold(
        tuple(fold.start for fold in folds),
        lambda sums, samples: tuple(fold.step(s, x) for fold, s, x in zip(folds, sums, samples, strict=True)),
        lambda sums: tuple(fold.value(s) for fold, s in zip(folds, sums, strict=True)),
    )


class TimeLoop(NamedTuple):
    """A loop over the rows of a record for many runs at once, inside JAX."""

    start: State  # state before the first row, run axis last
    # ``step(state, row) -> (state, observed)``, with the observed values of the row, (channel, run)
    step: Callable[[State, Any], tuple[State, Any]]
    rows: Any  # input that all runs share
    lead_in: int  # number of initial rows without stored values
    # ``usable(state)``: mask (run,) of the usable runs, from the state after the last row
    usable: Callable[[State], Any]
    unroll: int = 1  # rows per pass of XLA's loop

    def run(self) -> tuple[Any, Any]:
        """Run the loop and return the histories."""
        state, rows = self._led_in()
        state, outputs = lax.scan(self.step, state, rows, unroll=self.unroll)
        return outputs, self.usable(state)

    def folded(self, fold: Fold, beside: Any, make: Callable[[Any, Any], Any]) -> tuple[Any, Any]:
        """Run the loop and reduce the histories sample by sample; no history is kept."""

        def step(carried: tuple[State, Any], row: tuple[Any, Any]) -> tuple[tuple[State, Any], None]:
            state, outputs = self.step(carried[0], row[0])
            return (state, fold.step(carried[1], make(outputs, row[1]))), None

        state, rows = self._led_in()
        (state, sums), _ = lax.scan(step, (state, fold.start), (rows, beside), unroll=self.unroll)
        return fold.value(sums), self.usable(state)

    def _led_in(self) -> tuple[State, Any]:
        """Return the state after the initial rows without stored values, and the remaining rows."""
        if not self.lead_in:
            return self.start, self.rows
        first = jax.tree.map(lambda x: x[: self.lead_in], self.rows)
        rest = jax.tree.map(lambda x: x[self.lead_in :], self.rows)
        state, _ = lax.scan(lambda state, row: (self.step(state, row)[0], None), self.start, first)
        return state, rest


def with_sensitivities(loop_of: Callable[[Any], TimeLoop], parameters: Float[Array, "parameter run"]) -> TimeLoop:
    """Extend a loop over time by the sensitivities of its state to the parameters.

    For a state s with the step s ← f(s, p), the sensitivities S = ∂s/∂p have the step S ← ∂f/∂s S + ∂f/∂p.
    """
    loop, directions = loop_of(parameters), jnp.eye(parameters.shape[0])
    row = jax.tree.map(lambda x: x[0], loop.rows)
    converted, _ = jax.closure_convert(loop.step, loop.start, row)

    def constants(p: Any) -> tuple[Any, ...]:
        """Return parameter-dependent constants of a step, such as frequencies; they are differentiated before the loop."""
        loop = loop_of(p)
        return tuple(jax.closure_convert(loop.step, loop.start, row)[1])

    def along_all(function: Callable[..., Any], *points_and_slopes: tuple[Any, Any]) -> tuple[Any, Any]:
        """Return the value of a function and its derivatives along each parameter, from its input and the input's derivatives."""
        points, slopes = zip(*points_and_slopes, strict=True)

        def along(*slope: Any) -> tuple[Any, Any]:
            value: tuple[Any, Any] = jax.jvp(function, points, slope)
            return value

        result: tuple[Any, Any] = jax.vmap(along, out_axes=(None, 0))(*slopes)
        return result

    each = parameters, jnp.broadcast_to(directions[:, :, None], (*directions.shape, parameters.shape[1]))
    start, beforehand = along_all(lambda p: loop_of(p).start, each), along_all(constants, each)

    def step(carried: tuple[State, State], row: Any) -> tuple[tuple[State, State], tuple[Any, Any]]:
        after, slopes = along_all(
            lambda state, constants_of_step: converted(state, row, *constants_of_step), carried, beforehand
        )
        return (after[0], slopes[0]), (after[1], slopes[1])

    return TimeLoop(start, step, loop.rows, loop.lead_in, lambda state: loop.usable(state[0]), loop.unroll)


def once_along_each(function: Callable[[Any], Any], parameters: Float[Array, "run parameter"]) -> Any:
    """Evaluate a function of the parameters of many runs so that its derivative along each parameter is computed only once.

    A density may also have other parameters, such as those of the error model. The loop over time does not depend on
    them, so its sensitivities are computed once and apply to all directions of differentiation.
    """

    def with_slope(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
        value, slopes = with_slopes(function, primals[0])
        return value, jax.tree.map(lambda x: _contracted(tangents[0], x), slopes)

    result = jax.custom_jvp(function)
    result.defjvp(with_slope)
    return result(parameters)


def _contracted(directions: Any, slopes: Any) -> Any:
    """Return the directional derivative of each run (run, parameter) from the partial derivatives (parameter, …, run)."""
    if slopes.dtype == jax.dtypes.float0:  # derivatives of Booleans
        return np.zeros(slopes.shape[1:], dtype=jax.dtypes.float0)
    weights = directions.T.reshape(slopes.shape[0], *[1] * (slopes.ndim - 2), slopes.shape[-1])
    return (weights * slopes).sum(axis=0)


def all_finite(state: State) -> Bool[Array, " run"]:
    """Return a mask of the runs with a finite state."""
    parts = jax.tree.leaves(state)
    # A sum is finite only if all its parts are finite, so one test suffices.
    return jnp.isfinite(sum(part.reshape(-1, part.shape[-1]).sum(axis=0) for part in parts))
