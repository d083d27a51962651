"""A JAX function of many runs, compiled to vector code with one run per lane if possible, and otherwise run by JAX."""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.freed_memory import return_freed_memory
from structid.engine.device import jnp, over_runs
from structid.engine.lanes.blocks import on_all_cores
from structid.engine.lanes.kernel import ENTRY, Kernel, kernel
from structid.engine.lanes.machine import lanes, load, why_not
from structid.engine.lanes.signals import Signals
from structid.engine.lanes.splitting import by_jax, foreign_results, in_few_sizes
from structid.engine.matrices.row_by_row import row_by_row
from structid.engine.vector_code.operations import Function, largest_state
from structid.engine.vector_code.primitives import UntranslatableError
from structid.engine.vector_code.values import History

KEPT = 8
"""Maximum number of sets of constants for which a compiled function is kept."""

NUMBERS_IN_A_LINE = 8
"""Doubles in a cache line of 64 bytes."""

OF_ANOTHER_JAX = (KeyError, AttributeError)
"""Errors of the translation if this JAX version represents operations differently; JAX then runs the loop."""

_log = logging.getLogger(__name__)


class InLanes:
    """Compile a function of arrays with a leading run axis to vector code; the counterpart of `device.over_runs`.

    The function is traced for one run, and its jaxpr is translated to vector code. JAX runs the function if an operation has no
    vector code, or if no compiler is available.
    """

    def __init__(
        self, function: Callable[..., Any], run_axes: Any = 0, shard: bool = True, one_array: bool = False
    ) -> None:
        self._function, self._run_axes, self._one_array = function, run_axes, one_array
        self._by_jax = over_runs(function, run_axes, shard)
        self._shard = shard
        self._bound: dict[Any, tuple[list[Any], _Bound]] = {}
        self._by_jax_with_signals: dict[Any, Any] = {}
        self.why_not = why_not()

    def __reduce__(self) -> tuple[Any, ...]:
        # A process that receives a model compiles it, or loads the code that this process stored on disk.
        return InLanes, (self._function, self._run_axes, self._shard, self._one_array)

    def __call__(
        self, theta: Float[np.ndarray, "run parameter"], *constants: Any, signals: Signals | None = None
    ) -> Any:
        """Call the function."""
        theta = np.asarray(theta, dtype=np.float64)
        lanes = self.compiled(theta.shape[1], constants, None if signals is None else signals.shape)
        if lanes is not None:
            return lanes(theta, signals)
        if signals is None:
            return self._by_jax(theta, *constants)
        rows = np.hstack([theta, signals.of_runs.reshape(len(theta), -1)])
        return self._jax_of_rows(theta.shape[1], signals.shape)(rows, *constants)

    def _jax_of_rows(self, parameters: int, shape: tuple[int, int]) -> Callable[..., Any]:
        """Return the JAX version of the function; each row has the parameters and then the signals of a run."""
        if (parameters, shape) not in self._by_jax_with_signals:

            def function(rows: Any, *constants: Any) -> Any:
                signals = jnp.moveaxis(rows[:, parameters:].reshape(-1, *shape), 0, 2)
                return self._function(rows[:, :parameters], signals, *constants)

            self._by_jax_with_signals[parameters, shape] = over_runs(function, self._run_axes, self._shard)
        result: Callable[..., Any] = self._by_jax_with_signals[parameters, shape]
        return result

    def compiled(
        self, parameters: int, constants: tuple[Any, ...], signals: tuple[int, int] | None = None
    ) -> _Bound | None:
        """Compile the function, or reuse an earlier compilation."""
        if self.why_not:
            return None
        try:
            return self._kept(parameters, constants, signals)
        except (UntranslatableError, *OF_ANOTHER_JAX) as cause:
            translatable = isinstance(cause, UntranslatableError)
            self.why_not = (
                str(cause) if translatable else f"JAX {jax.__version__} represents operations differently ({cause!r})"
            )
            _log.info("JAX runs %s, since no vector code is possible: %s", self._function, cause)
            return None

    def _kept(self, parameters: int, constants: Any, signals: tuple[int, int] | None) -> _Bound:
        leaves = jax.tree.leaves(constants)
        key = (parameters, signals, leaves[0].shape if self._one_array else tuple(map(id, leaves)))
        if key not in self._bound:
            if len(self._bound) >= KEPT:
                self._bound.pop(next(iter(self._bound)))
            # The leaves are kept, so that no other array gets the same id.
            bound = _Bound(self._function, self._run_axes, parameters, constants, signals, self._one_array)
            self._bound[key] = leaves, bound
        leaves, result = self._bound[key]
        return result.with_array(leaves[0], constants[0]) if self._one_array else result


class _Bound:
    """A compiled function with its constants."""

    def __init__(
        self,
        function: Callable[..., Any],
        run_axes: Any,
        parameters: int,
        constants: Any,
        signals: Any,
        one_array: bool,
    ) -> None:
        shapes_of_one = [(1, parameters)] if signals is None else [(1, parameters), (*signals, 1)]
        shapes_of_one += [constants[0].shape] if one_array else []  # no constant may depend on it
        others = () if one_array else constants
        with row_by_row():
            traced, shapes = jax.make_jaxpr(lambda *own: function(*own, *others), return_shape=True)(
                *(jax.ShapeDtypeStruct(shape, np.float64) for shape in shapes_of_one)
            )
        leaves, self._tree = jax.tree.flatten(shapes)
        axes = jax.tree.map(lambda _: run_axes, shapes) if isinstance(run_axes, int) else run_axes
        flat = Function.inlined(traced).given(constants[0]) if one_array else Function.inlined(traced)
        foreign = foreign_results(flat)
        self._foreign = by_jax(flat, foreign) if foreign else None
        self._foreign_on_host = in_few_sizes(self._foreign) if self._foreign is not None else None
        self.kernel: Kernel = kernel(flat, lanes(largest_state(flat)), foreign)
        self._compiled = load(self.kernel.text, ENTRY)
        self._outputs = _outputs(self.kernel, leaves, jax.tree.leaves(axes))
        return_freed_memory()

    def with_array(self, old: np.ndarray, new: np.ndarray) -> _Bound:
        """Return a copy of the compiled function with the constant array `old` replaced by `new`."""
        result = copy.copy(self)
        result.kernel = self.kernel.with_array(old, new)
        return result

    def __call__(self, theta: np.ndarray, signals: Signals | None = None) -> Any:
        return self._run(theta, None if self._foreign_on_host is None else self._foreign_on_host(theta), signals)

    def inside_jax(self, theta: Float[Array, "run parameter"]) -> Any:
        """Call the function from inside JAX."""
        foreign = jnp.zeros((0, theta.shape[0])) if self._foreign is None else self._foreign(theta)
        shapes = [jax.ShapeDtypeStruct((theta.shape[0], *o.shape), o.kind) for o in self._outputs]

        def on_host(theta: Any, foreign: Any) -> list[np.ndarray]:
            # If JAX maps the call over an axis, this axis comes first here.
            theta, foreign = np.asarray(theta), np.asarray(foreign)
            rows = theta.reshape(-1, theta.shape[-1])
            numbers = np.moveaxis(foreign, -2, 0).reshape(foreign.shape[-2], len(rows))
            result = jax.tree.leaves(self._run(rows, numbers, None))
            first = [np.moveaxis(x, o.axis, 0) for x, o in zip(result, self._outputs, strict=True)]
            return [x.reshape(*theta.shape[:-1], *x.shape[1:]) for x in first]

        # All JAX computations precede the call. JAX inside the call would wait for a program that waits for the call.
        return jax.tree.unflatten(
            self._tree, jax.pure_callback(on_host, shapes, theta, foreign, vmap_method="broadcast_all")
        )

    def _run(self, theta: np.ndarray, foreign: np.ndarray | None, signals: Signals | None) -> Any:
        kernel, (count, columns) = self.kernel, theta.shape
        blocks = -(-count // kernel.width)
        stride = _row_length(blocks * kernel.width)
        arguments = _empty(kernel.taken, stride)
        arguments[:columns, :count], arguments[:columns, count:] = theta.T, theta[-1:].T
        if foreign is not None:
            arguments[columns:, :count] = foreign
            arguments[columns:, count:] = foreign[:, -1:]
        results, histories = _empty(kernel.rows, stride), _empty(kernel.histories, stride)
        next_block = np.zeros(1, dtype=np.int64)
        given = np.empty(0) if signals is None else signals.in_blocks(kernel.width)
        buffers = [a.ctypes.data for a in (arguments, kernel.shared, given, results, histories, next_block)]
        on_all_cores(lambda: self._compiled(*buffers, stride, blocks), blocks)
        parts = results, histories
        return jax.tree.unflatten(self._tree, [output.taken_from(parts, count) for output in self._outputs])


def _row_length(runs: int) -> int:
    """Return the padded length of an array row that holds one number per run.

    The length is an odd number of cache lines, because rows at power-of-two distances would evict each other from the cache.
    """
    lines = -(-runs // NUMBERS_IN_A_LINE)
    return NUMBERS_IN_A_LINE * (lines + 1 - lines % 2)


def _empty(rows: int, length: int) -> np.ndarray:
    """Return an array whose rows start at a cache line, so that different blocks never write to the same line."""
    memory = np.empty(rows * length + NUMBERS_IN_A_LINE)
    first = -memory.ctypes.data // memory.itemsize % NUMBERS_IN_A_LINE
    return memory[first : first + rows * length].reshape(rows, length)


@dataclass(frozen=True)
class _Output:
    """Location of one returned array among the rows of results or histories."""

    buffer: int
    first: int
    shape: tuple[int, ...]
    axis: int
    truths: bool

    @property
    def kind(self) -> type:
        """Data type of the array."""
        return bool if self.truths else float

    def taken_from(self, buffers: tuple[np.ndarray, np.ndarray], count: int) -> np.ndarray:
        """Read the returned array from the buffers, for the first `count` runs."""
        rows = buffers[self.buffer][self.first : self.first + math.prod(self.shape), :count]
        result = rows[0] if not self.shape else rows.reshape(*self.shape, count)
        if self.axis != len(self.shape):
            result = np.moveaxis(result, -1, self.axis)
        return result != 0.0 if self.truths else result


def _outputs(kernel: Kernel, leaves: list[Any], axes: list[int]) -> list[_Output]:
    """Return the locations of the returned arrays; `leaves` are the arrays of one run, `axes` their run axes."""
    result, row = [], 0
    for output, leaf, axis in zip(kernel.outputs, leaves, axes, strict=True):
        shape = tuple(n for i, n in enumerate(leaf.shape) if i != axis)
        if isinstance(output, History):
            result.append(_Output(1, output.first, shape, axis, truths=False))
        else:
            result.append(_Output(0, row, shape, axis, truths=leaf.dtype == np.bool_))
            row += math.prod(shape)
    return result
