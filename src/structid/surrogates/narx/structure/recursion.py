"""Recursion of a NARX inside JAX, which computes outputs from inputs and coefficients, one step ahead or in a free run.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.engine.time_loop import TimeLoop, all_finite
from structid.surrogates.narx.structure.terms import Memory, Term

State = dict[str, tuple[Any, ...]]
"""Values of every input, output and memory at t−1, t−2, …; each has shape (run,)."""

UNROLLED = 8
"""Number of recursion steps per pass of XLA's loop. The overhead of a pass is about the cost of a step of 50 runs."""


@dataclass(frozen=True, eq=False)
class Recursion:
    """A NARX structure, y_j(t) = Σᵢ ϑ_ji g_ji(z(t)) (thesis eqs. 2.52, 5.6), in scaled signals.

    The coefficients of one run form a vector: the coefficients of the terms of the first output, the second output, …, and then
    the shape parameters of the memories.
    """

    terms: tuple[tuple[Term, ...], ...]  # Terms of each output
    memories: tuple[Memory, ...]  # memories, each derived from an input, an output or an earlier memory
    inputs: tuple[str, ...]  # Names of the inputs
    outputs: tuple[str, ...]  # Names of the outputs
    dt: float  # Time step [s]
    scales: Mapping[str, float]  # Scales by which inputs, outputs and integrals are divided
    initial: Float[np.ndarray, " output"]  # Scaled outputs at the first sample

    @cached_property
    def depth(self) -> dict[str, int]:
        """Largest lag of each signal."""
        depth = dict.fromkeys([*self.inputs, *self.outputs, *(m.name for m in self.memories)], 1)
        for term in (t for of_output in self.terms for t in of_output):
            for signal, lag in term.signals:
                depth[signal] = max(depth[signal], lag)
        return depth

    @property
    def linear_size(self) -> int:
        """Number of coefficients of terms."""
        return sum(map(len, self.terms))

    @property
    def size(self) -> int:
        """Length of a coefficient vector."""
        return self.linear_size + sum(m.shapes for m in self.memories)

    @property
    def names(self) -> tuple[str, ...]:
        """Term or shape parameter of each coefficient."""
        several = len(self.outputs) > 1
        linear = [
            f"{y}: {t}" if several else str(t) for y, of in zip(self.outputs, self.terms, strict=True) for t in of
        ]
        return (*linear, *(f"{m.name}: {s}" for m in self.memories if m.shapes for s in ("b", "g")))

    # --- one step -----------------------------------------------------------------------------------------------

    def values(self, state: State, row: Float[Array, "_ ..."]) -> dict[tuple[str, int], Any]:
        """Collect every lagged signal at one time."""
        lagged = {(name, 0): row[i] for i, name in enumerate(self.inputs)}
        for signal, past in state.items():
            lagged.update({(signal, k): value for k, value in enumerate(past, 1)})
        return lagged

    def outputs_of(
        self, coefficients: Float[Array, "coefficient run"], values: Mapping[tuple[str, int], Any], time: Any
    ) -> list[Any]:
        """Compute the outputs one step ahead."""
        outputs, start = [], 0
        for of_output in self.terms:
            outputs.append(sum(coefficients[start + i] * t.evaluate(values, time) for i, t in enumerate(of_output)))
            start += len(of_output)
        return outputs

    def advance(
        self,
        coefficients: Float[Array, "coefficient run"],
        state: State,
        row: Float[Array, "_ ..."],
        outputs: Sequence[Any],
    ) -> State:
        """Add the inputs and outputs of one time to the state and update the memories."""
        # All runs may share an input, but each run has its own state.
        now = {name: jnp.broadcast_to(row[i], outputs[0].shape) for i, name in enumerate(self.inputs)}
        now |= dict(zip(self.outputs, outputs, strict=True))
        shape = self.linear_size
        for memory in self.memories:
            held = state[memory.name][0]
            s_now, s_before = now[memory.of], state[memory.of][0]
            if memory.kind == "integral":
                value = held + self._rate(memory) * 0.5 * (s_now + s_before)
            else:
                value = _hysteresis(held, s_now - s_before, coefficients[shape], coefficients[shape + 1])
            shape += memory.shapes
            now[memory.name] = value
        return {signal: (now[signal], *past[:-1]) for signal, past in state.items()}

    def step(
        self,
        coefficients: Float[Array, "coefficient run"],
        state: State,
        row: Float[Array, "_ ..."],
        time: Any,
        bound: float,
    ) -> State:
        """Simulate one step from the model's past outputs."""
        outputs = self.outputs_of(coefficients, self.values(state, row), time)
        return self.advance(coefficients, state, row, [_bounded(y, bound) for y in outputs])

    def _rate(self, memory: Memory) -> float:
        """Return the scaled increment of an integral for one step of its scaled signal."""
        return float(self.scales.get(memory.of, 1.0) * self.dt / self.scales[memory.name])

    def at_rest(self, like: Float[Array, " run"], row: Float[Array, "_ ..."]) -> State:
        """Return the state after the first sample: outputs have their initial values, and all earlier values are zero."""
        zero = like * 0.0
        state = {x: (zero + row[i], *[zero] * (self.depth[x] - 1)) for i, x in enumerate(self.inputs)}
        state |= {y: (zero + float(v),) * self.depth[y] for y, v in zip(self.outputs, self.initial, strict=True)}
        return state | {m.name: (zero,) * self.depth[m.name] for m in self.memories}

    def last(self, state: State) -> Float[Array, "output run"]:
        """Return the latest outputs in a state."""
        return jnp.stack([state[y][0] for y in self.outputs])

    # --- many steps ---------------------------------------------------------------------------------------------

    def free_loop(
        self,
        coefficients: Float[Array, "coefficient run"],
        signals: Float[Array, "time input *run"],
        bound: float,
        unroll: int = UNROLLED,
    ) -> TimeLoop:
        """Return a loop that simulates from the model's past outputs."""

        def step(state: State, at: Any) -> tuple[State, Any]:
            row, time = at
            # Return the previous output from the state. To return the new output, XLA would compute all terms twice.
            return self.step(coefficients, state, row, time, bound), self.last(state)

        start = self.at_rest(coefficients[0], signals[0])
        return TimeLoop(start, step, (signals[1:], self._times(signals)), 0, all_finite, unroll)

    def restarted_loop(
        self,
        coefficients: Float[Array, "coefficient run"],
        signals: Float[Array, "_ _ run"],
        again: Callable[[np.ndarray], Any],
        bound: float,
        unroll: int = UNROLLED,
    ) -> TimeLoop:
        """Return a loop that restarts from the measured past at given samples."""

        def step(carried: tuple[State, State], at: Any) -> tuple[tuple[State, State], Any]:
            (state, measured), (row, time, starts) = carried, at
            outputs_seen = self.last(state)
            state = jax.tree.map(lambda free, known: jnp.where(starts > 0, known, free), state, measured)
            after = self.step(coefficients, state, row, time, bound)
            return (after, self.advance(coefficients, measured, row, self.measured_outputs(row))), outputs_seen

        start = self._from_measured(coefficients[0], signals[0])
        times = self._times(signals)
        starts = np.asarray(again(np.arange(len(times)))).astype(float)
        return TimeLoop((start, start), step, (signals[1:], times, starts), 0, all_finite, unroll)

    def one_step_loop(
        self, coefficients: Float[Array, "coefficient run"], signals: Float[Array, "_ _ run"]
    ) -> TimeLoop:
        """Return a loop that evaluates the terms on measured outputs, for the regression of one-step outputs."""

        def step(state: State, at: Any) -> tuple[State, Any]:
            row, time = at
            values, measured = self.values(state, row), self.measured_outputs(row)
            ones = jnp.ones_like(measured[0])
            terms = jnp.stack([ones * t.evaluate(values, time) for of in self.terms for t in of])
            return self.advance(coefficients, state, row, measured), terms

        start = self._from_measured(coefficients[0], signals[0])
        return TimeLoop(start, step, (signals[1:], self._times(signals)), 0, all_finite)

    def measured_outputs(self, row: Float[Array, "_ run"]) -> list[Any]:
        """Return the measured outputs in a row of inputs and outputs."""
        return [row[len(self.inputs) + i] for i in range(len(self.outputs))]

    def _from_measured(self, like: Any, row: Any) -> State:
        """Return the state after the first sample, with the measured outputs."""
        start = self.at_rest(like, row)
        measured = zip(self.outputs, self.measured_outputs(row), strict=True)
        return start | {name: (y, *start[name][1:]) for name, y in measured}

    def _times(self, signals: Any) -> np.ndarray:
        """Return the times [s] from the second sample onwards."""
        return np.arange(1, signals.shape[0]) * self.dt


def _hysteresis(held: Any, change: Any, b: Any, g: Any) -> Any:
    """Take one step of Δm = Δs − b |Δs| m − g Δs |m|, by the midpoint rule."""

    def slope(m: Any) -> Any:
        return change - b * jnp.abs(change) * m - g * change * jnp.abs(m)

    # Memories that diverge stay finite, like outputs.
    return _bounded(held + slope(held + 0.5 * slope(held)), 1e3)


def _bounded(value: Any, bound: float) -> Any:
    """Clip a value to ± a bound; NaN becomes the bound. In XLA this takes a third of the time of the clip function."""
    return jnp.where(value < bound, jnp.where(value > -bound, value, -bound), bound)
