"""Representations of an array in the translation: constant, shared, in registers, or in a buffer of histories."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from structid.engine.vector_code.primitives import ARRANGEMENT, Array, UntranslatableError
from structid.engine.vector_code.registers import Number

UFUNCS: dict[str, np.ufunc] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "exp": np.exp,
    "log": np.log,
    "gt": np.greater,
    "lt": np.less,
}

IN_NUMPY: dict[str, Callable[..., Any]] = {
    **{name: functools.partial(lambda ufunc, _, *arrays: ufunc(*arrays), ufunc) for name, ufunc in UFUNCS.items()},
    "convert_element_type": lambda parameters, x: x.astype(parameters["new_dtype"]),
    "reduce_sum": lambda parameters, x: x.sum(axis=tuple(parameters["axes"])),
}
"""NumPy functions for operations that give equal results in NumPy and JAX: ``function(parameters, *arrays)``."""


@dataclass(frozen=True)
class Shared:
    """An array that all runs share. Its numbers are not in the LLVM code, so new numbers need no new compilation."""

    values: np.ndarray  # The numbers


@dataclass(frozen=True)
class SharedRow:
    """A row of a shared array, such as the input of a nested loop."""

    place: str  # name of the position of the first number
    shape: tuple[int, ...]


@dataclass(frozen=True)
class History:
    """A history kept by a loop over time, or signals passed to the function: rows of memory with a number for every run."""

    number: int  # index in the order of creation; `SIGNALS` for signals
    shape: tuple[int, ...]  # (time, …)
    first: int = 0  # index of the first row

    @property
    def base(self) -> str:
        """Name of the register with the address of the history in memory."""
        return "%signals" if self.number == SIGNALS else f"%kept{self.number}"

    @property
    def each(self) -> str:
        """Name of the register with the row spacing in memory."""
        return "%each_signal" if self.number == SIGNALS else f"%each{self.number}"

    @property
    def across(self) -> str:
        """Name of the register with the position of the current block's first run."""
        return "%across_signals" if self.number == SIGNALS else f"%across{self.number}"


@dataclass(frozen=True)
class InThreadMemory:
    """An array of each run that is too large for registers, in the memory of the thread that computes the block."""

    place: str  # name of the address of the first number; the lanes of a number are contiguous
    shape: tuple[int, ...]


SIGNALS = -1
"""Value of `History.number` for the signals of each run, which the caller passes to the function."""

Value = np.ndarray | Shared | SharedRow | History | InThreadMemory
"""An array: constants and registers, a shared array or a row of it, an array in thread memory, or a history."""


def is_known(value: Value) -> bool:
    """Whether the numbers of an array are known at compile time."""
    return isinstance(value, Shared) or (isinstance(value, np.ndarray) and value.dtype != object)


def size_of(value: Value) -> int:
    """Return the number of values in an array."""
    return value.values.size if isinstance(value, Shared) else int(np.prod(value.shape))


def known_values(value: Any) -> np.ndarray:
    """Return the values of an array that are known at compile time."""
    return value.values if isinstance(value, Shared) else value


def flattened(value: Value) -> Value:
    """Return an array with a single axis."""
    if isinstance(value, Shared):
        return Shared(value.values.reshape(-1))
    if isinstance(value, np.ndarray):
        return value.reshape(-1)
    return replace(value, shape=(size_of(value),))


def array_of(numbers: Sequence[Number], shape: tuple[int, ...]) -> Array:
    """Arrange numbers in an array."""
    result = np.empty(len(numbers), dtype=object)
    result[:] = numbers
    return result.reshape(shape)


MOVES = {"slice", "squeeze", "reshape", "expand_dims", "transpose", "broadcast_in_dim"}
"""Operations on a history that change only the addresses at which its numbers are read."""


def moved(name: str, parameters: dict[str, Any], history: History, shape: tuple[int, ...]) -> History | None:
    """Return a slice or rearrangement of a history as other addresses of the same memory, or None."""
    if name != "slice":
        order = parameters["permutation"] if name == "transpose" else ()
        longer = [axis for axis in order if history.shape[axis] > 1]
        if math.prod(shape) != size_of(history) or longer != sorted(longer):
            return None
        return replace(history, shape=shape)
    starts, lengths = parameters["start_indices"], np.subtract(parameters["limit_indices"], parameters["start_indices"])
    # The numbers are contiguous if all axes after the first axis longer than one are complete.
    cut = int(np.argmax(lengths != 1)) + 1 if (lengths != 1).any() else len(lengths)
    if tuple(lengths[cut:]) != history.shape[cut:] or set(parameters["strides"] or (1,)) != {1}:
        return None
    return replace(history, shape=shape, first=history.first + int(np.ravel_multi_index(starts, history.shape)))


def gathered(primitive: Any, parameters: dict[str, Any], numbers: Array, indices: np.ndarray) -> Array:
    """Select numbers by indices known at compile time; JAX applies the selection to the numbers' positions."""
    places = np.asarray(primitive.bind(np.arange(numbers.size).reshape(numbers.shape), indices, **parameters))
    if places.min(initial=0) < 0 or places.max(initial=0) >= numbers.size:
        raise UntranslatableError("indices beyond an array")
    return array_of(numbers.reshape(-1)[places.reshape(-1)], places.shape)


def computed_now(primitive: Any, parameters: dict[str, Any], operands: Sequence[Any]) -> list[Value]:
    """Evaluate an operation at compile time."""
    arrays = _values(primitive, parameters, [known_values(x) for x in operands])
    return [Shared(x) for x in arrays] if any(isinstance(x, Shared) for x in operands) else list(arrays)


def _values(primitive: Any, parameters: dict[str, Any], operands: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Evaluate an operation by NumPy if possible, since JAX would compile each operation."""
    name = primitive.name
    if name in ARRANGEMENT:
        return [np.asarray(ARRANGEMENT[name](parameters, *operands), dtype=operands[0].dtype)]
    if name in IN_NUMPY:
        return [np.asarray(IN_NUMPY[name](parameters, *operands))]
    result = primitive.bind(*operands, **parameters)
    return [np.asarray(x) for x in (result if primitive.multiple_results else [result])]
