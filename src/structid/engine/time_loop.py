"""A loop over the samples of a record, defined once: run to histories, or reduced to a few sums on the way."""

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
"""A tree of arrays with the run axis last."""


class Fold(NamedTuple):
    """A reduction of a history, sample by sample, where the history itself is not needed."""

    start: Any  # sums before the first sample
    step: Callable[[Any, Any], Any]  # ``step(sums, sample) -> sums``
    value: Callable[[Any], Any]  # ``value(sums)``: the final result

    def of(self, series: Any) -> Any:
        """Reduce an existing history."""
        sums, _ = lax.scan(lambda sums, sample: (self.step(sums, sample), None), self.start, series)
        return self.value(sums)


def sum_of_squares(nothing: Any) -> Fold:
    """Fold that computes Σ x²."""
    return Fold(nothing, lambda sums, sample: sums + sample**2, lambda sums: sums)


def side_by_side(folds: Sequence[Fold]) -> Fold:
    """Combine several folds of one history."""
    return Fold(
        tuple(fold.start for fold in folds),
        lambda sums, samples: tuple(fold.step(s, x) for fold, s, x in zip(folds, sums, samples, strict=True)),
        lambda sums: tuple(fold.value(s) for fold, s in zip(folds, sums, strict=True)),
    )


class TimeLoop(NamedTuple):
    """A loop over the rows of a record for many runs at once, inside JAX."""

    start: State  # state before the first row, run axis last
    # ``step(state, row) -> (state, seen)``, with what is seen of the row, (channel, run)
    step: Callable[[State, Any], tuple[State, Any]]
    rows: Any  # input that all runs share
    lead_in: int  # number of initial rows for which nothing is kept
    # ``usable(state)``: which runs can be used, (run,), from the state after the last row
    usable: Callable[[State], Any]
    unroll: int = 1  # rows per pass of XLA's loop

    def run(self) -> tuple[Any, Any]:
        """Run and keep histories."""
        state, rows = self._led_in()
        state, outputs = lax.scan(self.step, state, rows, unroll=self.unroll)
        return outputs, self.usable(state)

    def folded(self, fold: Fold, beside: Any, make: Callable[[Any, Any], Any]) -> tuple[Any, Any]:
        """Run and reduce on the way; no history is kept."""

        def step(carried: tuple[State, Any], row: tuple[Any, Any]) -> tuple[tuple[State, Any], None]:
            state, outputs = self.step(carried[0], row[0])
            return (state, fold.step(carried[1], make(outputs, row[1]))), None

        state, rows = self._led_in()
        (state, sums), _ = lax.scan(step, (state, fold.start), (rows, beside), unroll=self.unroll)
        return fold.value(sums), self.usable(state)

    def _led_in(self) -> tuple[State, Any]:
        """State after the lead-in, and the remaining rows."""
        if not self.lead_in:
            return self.start, self.rows
        first = jax.tree.map(lambda x: x[: self.lead_in], self.rows)
        rest = jax.tree.map(lambda x: x[self.lead_in :], self.rows)
        state, _ = lax.scan(lambda state, row: (self.step(state, row)[0], None), self.start, first)
        return state, rest


def with_sensitivities(loop_of: Callable[[Any], TimeLoop], parameters: Float[Array, "parameter run"]) -> TimeLoop:
    """Extend a loop over time by the sensitivities to its parameters.

    With the step s ← f(s, p) of a state s, its sensitivities S = ∂s/∂p follow S ← ∂f/∂s S + ∂f/∂p.
    """
    loop, directions = loop_of(parameters), jnp.eye(parameters.shape[0])
    row = jax.tree.map(lambda x: x[0], loop.rows)
    converted, _ = jax.closure_convert(loop.step, loop.start, row)

    def constants(p: Any) -> tuple[Any, ...]:
        """What a step needs of the parameters, such as frequencies of a matrix: computed and differentiated before the loop."""
        loop = loop_of(p)
        return tuple(jax.closure_convert(loop.step, loop.start, row)[1])

    def along_all(function: Callable[..., Any], *points_and_slopes: tuple[Any, Any]) -> tuple[Any, Any]:
        """Value of a function and its derivatives along each parameter, from its input and the slopes of that input."""
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

    A density may be differentiated along many more directions, such as those of the noise. The loop in the function does not
    depend on these, so its sensitivities serve all of them.
    """

    def with_slope(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
        value, slopes = with_slopes(function, primals[0])
        return value, jax.tree.map(lambda x: _contracted(tangents[0], x), slopes)

    result = jax.custom_jvp(function)
    result.defjvp(with_slope)
    return result(parameters)


def _contracted(directions: Any, slopes: Any) -> Any:
    """Directional derivative for each run (run, parameter), from the derivatives along each parameter (parameter, …, run)."""
    if slopes.dtype == jax.dtypes.float0:  # of truths
        return np.zeros(slopes.shape[1:], dtype=jax.dtypes.float0)
    weights = directions.T.reshape(slopes.shape[0], *[1] * (slopes.ndim - 2), slopes.shape[-1])
    return (weights * slopes).sum(axis=0)


def all_finite(state: State) -> Bool[Array, " run"]:
    """Which runs have a finite state."""
    parts = jax.tree.leaves(state)
    # A sum is finite only if all its parts are, and takes one test.
    return jnp.isfinite(sum(part.reshape(-1, part.shape[-1]).sum(axis=0) for part in parts))
