"""The recursion of a NARX model inside JAX: from inputs and coefficients to outputs, one step ahead or free-running.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np

from structid.device import jnp
from structid.mechanics.time_loop import TimeLoop, all_finite
from structid.surrogates.array_module import namespace
from structid.surrogates.narx.terms import Memory, Term

State = dict[str, tuple[Any, ...]]
"""The values of every output and memory at t−1, t−2, …, each of shape (run,)."""

UNROLLED = 8
"""Steps of the recursion in one pass of the loop of XLA. The overhead of a pass is about the cost of a step of 50 runs."""


@dataclass(frozen=True, eq=False)
class Recursion:
    """A NARX structure, y_j(t) = Σᵢ ϑ_ji g_ji(z(t)) (thesis eqs. 2.52, 5.6), in scaled signals.

    The coefficients of one run are a vector: those of the terms of the first output, of the second, …, and then the shape
    parameters of the memories.

    Parameters
    ----------
    terms : tuple of tuple of Term
        Terms of each output.
    memories : tuple of Memory
        Memories, each made from an input, an output or an earlier memory.
    inputs, outputs : tuple of str
        Names of the signals.
    dt : float
        Time step [s].
    scales : mapping of str to float
        Scales by which inputs, outputs and integrals are divided.
    initial : ndarray, shape (output,)
        Scaled outputs at the first sample.
    """

    terms: tuple[tuple[Term, ...], ...]
    memories: tuple[Memory, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    scales: Mapping[str, float]
    initial: np.ndarray

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
        """The term or shape parameter that each coefficient belongs to."""
        several = len(self.outputs) > 1
        linear = [
            f"{y}: {t}" if several else str(t) for y, of in zip(self.outputs, self.terms, strict=True) for t in of
        ]
        return (*linear, *(f"{m.name}: {s}" for m in self.memories if m.shapes for s in ("b", "g")))

    # --- one step -----------------------------------------------------------------------------------------------

    def values(self, state: State, window: Any) -> dict[tuple[str, int], Any]:
        """Collect every lagged signal at one time.

        Parameters
        ----------
        state : State
            Past outputs and memories.
        window : jax.Array, shape (input, lag + 1, ...)
            The inputs now and before.

        Returns
        -------
        dict of Lagged to array
            The lagged signals that terms may use.
        """
        known = {(s, k): window[i, k] for i, s in enumerate(self.inputs) for k in range(self.depth[s] + 1)}
        for signal, past in state.items():
            known.update({(signal, k): value for k, value in enumerate(past, 1)})
        return known

    def outputs_of(self, coefficients: Any, values: Mapping[tuple[str, int], Any], time: Any) -> list[Any]:
        """Compute the outputs one step ahead.

        Parameters
        ----------
        coefficients : jax.Array, shape (coefficient, run)
            ϑ.
        values : mapping
            Lagged signals.
        time : jax.Array
            Time [s].

        Returns
        -------
        list of jax.Array, shape (run,)
            One for each output.
        """
        found, start = [], 0
        for of_output in self.terms:
            found.append(sum(coefficients[start + i] * t.evaluate(values, time) for i, t in enumerate(of_output)))
            start += len(of_output)
        return found

    def advance(self, coefficients: Any, state: State, window: Any, outputs: Sequence[Any]) -> State:
        """Add the new outputs to the state and update the memories.

        Parameters
        ----------
        coefficients : jax.Array, shape (coefficient, run)
            ϑ; only the shapes at its end are used.
        state : State
            The state before the step.
        window : jax.Array, shape (input, lag + 1, ...)
            The inputs now and before.
        outputs : sequence of jax.Array, shape (run,)
            The outputs now.

        Returns
        -------
        State
            The state after the step.
        """
        new = dict(zip(self.outputs, outputs, strict=True))
        now = {**{s: window[i, 0] for i, s in enumerate(self.inputs)}, **new}
        before = {s: window[i, 1] for i, s in enumerate(self.inputs)} | {s: past[0] for s, past in state.items()}
        shape = self.linear_size
        for memory in self.memories:
            held = state[memory.name][0]
            s_now, s_before = now[memory.of], before[memory.of]
            if memory.kind == "integral":
                value = held + self._rate(memory) * 0.5 * (s_now + s_before)
            else:
                value = _hysteresis(held, s_now - s_before, coefficients[shape], coefficients[shape + 1])
            shape += memory.shapes
            now[memory.name] = new[memory.name] = value
        return {signal: (new[signal], *past[:-1]) for signal, past in state.items()}

    def _rate(self, memory: Memory) -> float:
        """Scaled increment of an integral for one step of its scaled signal."""
        return float(self.scales.get(memory.of, 1.0) * self.dt / self.scales[memory.name])

    def at_rest(self, like: Any) -> State:
        """Return the state before the second sample: outputs at their initial values, memories zero.

        Parameters
        ----------
        like : jax.Array, shape (run,)
            Any array with one value for each run.

        Returns
        -------
        State
            The state.
        """
        zero = like * 0.0
        state = {y: (zero + float(v),) * self.depth[y] for y, v in zip(self.outputs, self.initial, strict=True)}
        return state | {m.name: (zero,) * self.depth[m.name] for m in self.memories}

    # --- many steps ---------------------------------------------------------------------------------------------

    def windows(self, x: Any) -> Any:
        """Return lagged copies of the inputs, which are zero before the record.

        Parameters
        ----------
        x : jax.Array, shape (time, input, ...)
            Scaled inputs.

        Returns
        -------
        jax.Array, shape (time, input, lag + 1, ...)
            x(t), x(t−1), …
        """
        deepest = max(self.depth[s] for s in self.inputs)
        numpy = namespace(x)
        copies = [x if k == 0 else numpy.concatenate([numpy.zeros_like(x[:k]), x[:-k]]) for k in range(deepest + 1)]
        return numpy.stack(copies, axis=2)

    def free_loop(self, coefficients: Any, x: Any, bound: float, unroll: int = UNROLLED) -> TimeLoop:
        """Give the loop that simulates from the past outputs of the model itself.

        Parameters
        ----------
        coefficients : jax.Array, shape (coefficient, run)
            ϑ of every run.
        x : array, shape (time, input) or (time, input, run)
            Scaled inputs.
        bound : float
            Outputs are kept within ± this value, so that a run that diverges stays finite.
        unroll : int
            Steps in one pass of the loop of XLA.

        Returns
        -------
        TimeLoop
            What is seen are the scaled outputs (output, run).
        """

        def step(state: State, at: Any) -> tuple[State, Any]:
            window, time = at
            found = self.outputs_of(coefficients, self.values(state, window), time)
            found = [_bounded(y, bound) for y in found]
            # The step shows the previous output, which the state holds: to show the new one XLA would compute all terms
            # twice.
            return self.advance(coefficients, state, window, found), self.last(state)

        # The row of a sample holds what the next one needs. The last row's step is nobody's.
        windows, times = self.windows(x), np.arange(x.shape[0]) * self.dt
        rows = (_from_second(windows), _from_second(times))
        return TimeLoop(self.at_rest(coefficients[0]), step, rows, 0, all_finite, unroll)

    def free_run(self, coefficients: Any, x: Any, bound: float, unroll: int = UNROLLED) -> Any:
        """Simulate from the past outputs of the model itself.

        Parameters
        ----------
        coefficients : jax.Array, shape (coefficient, run)
            ϑ of every run.
        x : array, shape (time, input) or (time, input, run)
            Scaled inputs.
        bound : float
            Outputs are kept within ± this value.
        unroll : int
            Steps in one pass of the loop of XLA.

        Returns
        -------
        jax.Array, shape (time, output, run)
            Scaled outputs.
        """
        return self.free_loop(coefficients, x, bound, unroll).run()[0]

    def last(self, state: State) -> Any:
        """Latest outputs in a state.

        Parameters
        ----------
        state : State
            The state.

        Returns
        -------
        jax.Array, shape (output, run)
            Scaled.
        """
        return jnp.stack([state[y][0] for y in self.outputs])

    def multi_step(
        self, coefficients: Any, x: Any, y: Any, horizon: int, bound: float, unrolled: int = UNROLLED
    ) -> Any:
        """Simulate, and start again from the measured past every `horizon` samples.

        Parameters
        ----------
        coefficients : jax.Array, shape (coefficient, run)
            ϑ of every run.
        x : jax.Array, shape (time, input, run)
            Scaled inputs.
        y : jax.Array, shape (time, output, run)
            Scaled measured outputs.
        horizon : int
            Samples between two starts; 1 is one step ahead.
        bound : float
            Outputs are kept within ± this value.
        unrolled : int
            Steps in one pass of the loop of XLA.

        Returns
        -------
        jax.Array, shape (time, output, run)
            Scaled outputs.
        """

        def step(carried: tuple[State, State], at: Any) -> tuple[tuple[State, State], Any]:
            state, measured = carried
            window, now, time, again = at
            state = jax.tree.map(lambda free, known: jnp.where(again, known, free), state, measured)
            found = self.outputs_of(coefficients, self.values(state, window), time)
            found = [_bounded(v, bound) for v in found]
            after = self.advance(coefficients, state, window, found)
            return (after, self.advance(coefficients, measured, window, list(now))), jnp.stack(found)

        start = self._from_measured(y)
        numbers = jnp.arange(x.shape[0])
        series = (self.windows(x)[1:], y[1:], numbers[1:] * self.dt, (numbers[1:] - 1) % horizon == 0)
        _, rest = jax.lax.scan(step, (start, start), series, unroll=unrolled)
        return jnp.concatenate([y[:1], rest])

    def _from_measured(self, y: Any) -> State:
        """State before the second sample, from the first measured output; every part of it has one value for each run."""
        start = self.at_rest(y[0, 0])
        return start | {name: (y[0, i], *start[name][1:]) for i, name in enumerate(self.outputs)}

    def one_step(self, coefficients: Any, x: Any, y: Any) -> Any:
        """Compute the terms along measured outputs, for regression: outputs one step ahead are linear in them.

        Parameters
        ----------
        coefficients : jax.Array, shape (coefficient, run)
            ϑ of every run; only the shapes of the memories, at its end, are used.
        x : jax.Array, shape (time, input, run)
            Scaled inputs.
        y : jax.Array, shape (time, output, run)
            Scaled outputs.

        Returns
        -------
        jax.Array, shape (time − 1, term, run)
            Terms of all outputs.
        """

        def step(state: State, at: Any) -> tuple[State, Any]:
            window, now, time = at
            values = self.values(state, window)
            ones = jnp.ones_like(now[0])
            terms = jnp.stack([ones * t.evaluate(values, time) for of in self.terms for t in of])
            return self.advance(coefficients, state, window, list(now)), terms

        times = jnp.arange(x.shape[0]) * self.dt
        return jax.lax.scan(step, self._from_measured(y), (self.windows(x)[1:], y[1:], times[1:]))[1]


def _from_second(rows: Any) -> Any:
    """Rows from the second on, the last one twice."""
    return namespace(rows).concatenate([rows[1:], rows[-1:]])


def _hysteresis(held: Any, change: Any, b: Any, g: Any) -> Any:
    """One step of Δm = Δs − b |Δs| m − g Δs |m|, by the midpoint rule."""

    def slope(m: Any) -> Any:
        return change - b * jnp.abs(change) * m - g * change * jnp.abs(m)

    # A memory that diverges stays finite, as outputs do.
    return _bounded(held + slope(held + 0.5 * slope(held)), 1e3)


def _bounded(value: Any, bound: float) -> Any:
    """Keep a value within ± a bound; NaN becomes the bound. In XLA this takes a third of the time of a clip."""
    return jnp.where(value < bound, jnp.where(value > -bound, value, -bound), bound)
