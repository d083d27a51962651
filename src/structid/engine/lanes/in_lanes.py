"""A JAX function of many runs, done in compiled lanes where that can be, and by JAX where not."""

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
"""Sets of constants for which a function stays compiled."""

NUMBERS_IN_A_LINE = 8
"""Numbers in a line of a processor's cache, 64 bytes."""

OF_ANOTHER_JAX = (KeyError, AttributeError)
"""What goes wrong where a later JAX lists operations in another way: the loop is left to it."""

_log = logging.getLogger(__name__)


class InLanes:
    """Compile a function of arrays with a leading run axis, each run on its own: `device.over_runs`, in lanes.

    The function is traced for one run, and what JAX lists of it is written as vector code. Where something in it has no vector
    code, or nothing can be compiled here, JAX runs it.
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
        # A process that is sent a model compiles it for itself, or finds what this one compiled on disk.
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
        """The function by JAX, of rows with the parameters and then the signals of a run."""
        if (parameters, shape) not in self._by_jax_with_signals:

            def function(rows: Any, *constants: Any) -> Any:
                signals = jnp.moveaxis(rows[:, parameters:].reshape(-1, *shape), 0, 2)
                return self._function(rows[:, :parameters], signals, *constants)

            self._by_jax_with_signals[parameters, shape] = over_runs(function, self._run_axes, self._shard)
        found: Callable[..., Any] = self._by_jax_with_signals[parameters, shape]
        return found

    def compiled(
        self, parameters: int, constants: tuple[Any, ...], signals: tuple[int, int] | None = None
    ) -> _Bound | None:
        """Compile the function, or take it from where it was compiled before."""
        if self.why_not:
            return None
        try:
            return self._kept(parameters, constants, signals)
        except (UntranslatableError, *OF_ANOTHER_JAX) as cause:
            known = isinstance(cause, UntranslatableError)
            self.why_not = str(cause) if known else f"JAX {jax.__version__} lists operations in another way ({cause!r})"
            _log.info("JAX runs %s, since lanes cannot: %s", self._function, cause)
            return None

    def _kept(self, parameters: int, constants: Any, signals: tuple[int, int] | None) -> _Bound:
        leaves = jax.tree.leaves(constants)
        key = (parameters, signals, leaves[0].shape if self._one_array else tuple(map(id, leaves)))
        if key not in self._bound:
            if len(self._bound) >= KEPT:
                self._bound.pop(next(iter(self._bound)))
            # The leaves are kept, so that no other array gets their identity.
            bound = _Bound(self._function, self._run_axes, parameters, constants, signals, self._one_array)
            self._bound[key] = leaves, bound
        leaves, found = self._bound[key]
        return found.with_array(leaves[0], constants[0]) if self._one_array else found


class _Bound:
    """A function with its constants, compiled."""

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
        shapes_of_one += [constants[0].shape] if one_array else []  # nothing is computed from the array beforehand
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

    def with_array(self, old: np.ndarray, new: np.ndarray) -> _Bound:
        """The same function with another array for its constant, old."""
        found = copy.copy(self)
        found.kernel = self.kernel.with_array(old, new)
        return found

    def __call__(self, theta: np.ndarray, signals: Signals | None = None) -> Any:
        return self._run(theta, None if self._foreign_on_host is None else self._foreign_on_host(theta), signals)

    def inside_jax(self, theta: Float[Array, "run parameter"]) -> Any:
        """Call the function from inside JAX."""
        foreign = jnp.zeros((0, theta.shape[0])) if self._foreign is None else self._foreign(theta)
        shapes = [jax.ShapeDtypeStruct((theta.shape[0], *o.shape), o.kind) for o in self._outputs]

        def on_host(theta: Any, foreign: Any) -> list[np.ndarray]:
            # Where JAX maps the call over an axis, here it comes first.
            theta, foreign = np.asarray(theta), np.asarray(foreign)
            rows = theta.reshape(-1, theta.shape[-1])
            numbers = np.moveaxis(foreign, -2, 0).reshape(foreign.shape[-2], len(rows))
            found = jax.tree.leaves(self._run(rows, numbers, None))
            first = [np.moveaxis(x, o.axis, 0) for x, o in zip(found, self._outputs, strict=True)]
            return [x.reshape(*theta.shape[:-1], *x.shape[1:]) for x in first]

        # What runs need of JAX comes before the call: JAX within it would wait for the program that waits for the call.
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
    """Length of a row of numbers of so many runs in memory.

    An odd number of cache lines: where the rows of a block were a power of two apart, they would push each other out of the cache.
    """
    lines = -(-runs // NUMBERS_IN_A_LINE)
    return NUMBERS_IN_A_LINE * (lines + 1 - lines % 2)


def _empty(rows: int, length: int) -> np.ndarray:
    """Rows of numbers that begin with a line of the cache, so that no two blocks write into the same line."""
    memory = np.empty(rows * length + NUMBERS_IN_A_LINE)
    first = -memory.ctypes.data // memory.itemsize % NUMBERS_IN_A_LINE
    return memory[first : first + rows * length].reshape(rows, length)


@dataclass(frozen=True)
class _Output:
    """Where one array that a function returns is found: some rows of the results, or of the histories."""

    buffer: int
    first: int
    shape: tuple[int, ...]
    axis: int
    truths: bool

    @property
    def kind(self) -> type:
        """Of its numbers."""
        return bool if self.truths else float

    def taken_from(self, buffers: tuple[np.ndarray, np.ndarray], count: int) -> np.ndarray:
        """The array of so many runs."""
        rows = buffers[self.buffer][self.first : self.first + math.prod(self.shape), :count]
        found = rows[0] if not self.shape else rows.reshape(*self.shape, count)
        if self.axis != len(self.shape):
            found = np.moveaxis(found, -1, self.axis)
        return found != 0.0 if self.truths else found


def _outputs(kernel: Kernel, leaves: list[Any], axes: list[int]) -> list[_Output]:
    """Places of what a function returns: `leaves` of one run, the run axis of each among `axes`."""
    found, row = [], 0
    for place, leaf, axis in zip(kernel.outputs, leaves, axes, strict=True):
        shape = tuple(n for i, n in enumerate(leaf.shape) if i != axis)
        if isinstance(place, History):
            found.append(_Output(1, place.first, shape, axis, truths=False))
        else:
            found.append(_Output(0, row, shape, axis, truths=leaf.dtype == np.bool_))
            row += math.prod(shape)
    return found
