"""Fourth-order Runge-Kutta over a sampled excitation, for many runs at once, inside JAX."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
from jax import lax
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.time_loop import State, TimeLoop, all_finite


class Watch(NamedTuple):
    """Monitor of a loop over time, which checks whether the time steps are short enough for the equations."""

    start: State  # initial value
    seen: Callable[[State, State, Any], State]  # ``seen(watched, state, input)``: the value after another sample
    # ``followed(state, watched, step)``: mask (run,) of the accurate runs, evaluated at the end of the record
    followed: Callable[[State, State, Any], Any]


def runge_kutta_4(rate: Callable[[State, Any], State], state: State, inputs: tuple[Any, Any, Any], step: Any) -> State:
    """Take one step of the classical Runge-Kutta method.

    k₁ = f(y, x₀), k₂ = f(y + h/2 k₁, x_½), k₃ = f(y + h/2 k₂, x_½), k₄ = f(y + h k₃, x₁),
    y ← y + h/6 (k₁ + 2k₂ + 2k₃ + k₄)
    """
    start, middle, end = inputs

    each = _each_array if isinstance(state, dict) else jax.tree.map

    def moved(slope: State, by: float) -> State:
        return each(lambda y, k: y + by * k, state, slope)

    k1 = rate(state, start)
    k2 = rate(moved(k1, 0.5 * step), middle)
    k3 = rate(moved(k2, 0.5 * step), middle)
    k4 = rate(moved(k3, step), end)
    return each(lambda y, a, b, c, d: y + step / 6.0 * (a + 2.0 * (b + c) + d), state, k1, k2, k3, k4)


def _each_array(function: Callable[..., Any], *states: dict[str, Any]) -> dict[str, Any]:
    """Apply a function to dictionaries of arrays, faster than `jax.tree.map` for NumPy arrays."""
    return {name: function(*(state[name] for state in states)) for name in states[0]}


def runge_kutta_loop(
    rate: Callable[[State, Any], State],
    inputs_of: Callable[[Any], tuple[Any, Any, Any]],
    observe: Callable[[State, Any], Any],
    start: State,
    stages: Float[Array, "time substeps 3"],
    dt: float,
    lead_in: int = 0,
    watch: Watch | None = None,
) -> TimeLoop:
    """Return a loop that integrates over a record and observes the state at every sample."""
    substeps = stages.shape[1]
    step = dt / substeps

    def substep(state: State, stage: Any) -> tuple[State, None]:
        return runge_kutta_4(rate, state, inputs_of(stage), step), None

    def sample(state: State, row: Any) -> tuple[State, Any]:
        # The state is observed before the step, so the first sample needs no extra row.
        outputs = observe(state, inputs_of(row[0])[0])
        if substeps == 1:
            state, _ = substep(state, row[0])
        else:
            # The inner loop is compiled into one kernel, so three substeps take little more time than one.
            state, _ = lax.scan(substep, state, row)
        return state, outputs

    if watch is None:
        return TimeLoop(start, sample, stages, lead_in, all_finite)

    def watched_sample(carried: tuple[State, State], row: Any) -> tuple[tuple[State, State], Any]:
        state, watched = carried
        watched = watch.seen(watched, state, inputs_of(row[0])[0])
        state, outputs = sample(state, row)
        return (state, watched), outputs

    def usable(carried: tuple[State, State]) -> Any:
        return all_finite(carried) & watch.followed(*carried, step)

    return TimeLoop((start, watch.start), watched_sample, stages, lead_in, usable)
