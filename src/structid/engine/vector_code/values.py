"""Arrays as a translation knows them: in the text, in the table that all runs share, in registers, or in a buffer of histories."""

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
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "sqrt": np.sqrt,
    "abs": np.abs, "exp": np.exp, "log": np.log, "gt": np.greater, "lt": np.less,
}  # fmt: skip

IN_NUMPY: dict[str, Callable[..., Any]] = {
    **{name: functools.partial(lambda ufunc, _, *arrays: ufunc(*arrays), ufunc) for name, ufunc in UFUNCS.items()},
    "convert_element_type": lambda parameters, x: x.astype(parameters["new_dtype"]),
    "reduce_sum": lambda parameters, x: x.sum(axis=tuple(parameters["axes"])),
}
"""Operations that NumPy does as JAX does: ``function(parameters, *arrays)``."""


@dataclass(frozen=True)
class Shared:
    """An array that all runs share. Its numbers are not in the text: other numbers need no other code."""

    values: np.ndarray  # The numbers


@dataclass(frozen=True)
class SharedRow:
    """A row of an array that all runs share, such as one that a loop inside a loop goes through."""

    place: str  # Name of the place of its first number
    shape: tuple[int, ...]


@dataclass(frozen=True)
class History:
    """What a loop over time kept, or signals that it goes through: rows of memory, each with a number for every run."""

    number: int  # Which one, in the order in which they are made; `SIGNALS` for those that the runs are given
    shape: tuple[int, ...]  # (time, …)
    first: int = 0  # Number of its first row

    @property
    def base(self) -> str:
        """Name of the memory where it is."""
        return "%signals" if self.number == SIGNALS else f"%kept{self.number}"

    @property
    def each(self) -> str:
        """Name of the distance from row to row."""
        return "%each_signal" if self.number == SIGNALS else f"%each{self.number}"

    @property
    def across(self) -> str:
        """Name of the place of the first run of the block that is under way."""
        return "%across_signals" if self.number == SIGNALS else f"%across{self.number}"


@dataclass(frozen=True)
class InMemory:
    """An array of each run that is too large for registers, in the memory of the thread that works on its block."""

    place: str  # Name of the address of its first number; the lanes of a number lie side by side
    shape: tuple[int, ...]


SIGNALS = -1
"""Stands for the signals that each run is given."""

Value = np.ndarray | Shared | SharedRow | History | InMemory
"""Constants that stand in the text, numbers shared by all runs or a row of them, numbers in registers or memory, or a history."""


def is_known(value: Value) -> bool:
    """Say whether the numbers of an array are known before the code runs."""
    return isinstance(value, Shared) or (isinstance(value, np.ndarray) and value.dtype != object)


def size_of(value: Value) -> int:
    """Count the numbers of an array."""
    return value.values.size if isinstance(value, Shared) else int(np.prod(value.shape))


def known_values(value: Any) -> np.ndarray:
    """Give the numbers of an array that are known."""
    return value.values if isinstance(value, Shared) else value


def flattened(value: Value) -> Value:
    """See an array as a row of numbers."""
    if isinstance(value, Shared):
        return Shared(value.values.reshape(-1))
    if isinstance(value, np.ndarray):
        return value.reshape(-1)
    return replace(value, shape=(size_of(value),))


def array_of(numbers: Sequence[Number], shape: tuple[int, ...]) -> Array:
    """Put numbers into an array."""
    found = np.empty(len(numbers), dtype=object)
    found[:] = numbers
    return found.reshape(shape)


MOVES = {"slice", "squeeze", "reshape", "expand_dims", "transpose", "broadcast_in_dim"}
"""Operations that may only say where the numbers of a history are."""


def moved(name: str, parameters: dict[str, Any], history: History, shape: tuple[int, ...]) -> History | None:
    """Say where an operation finds the numbers of a history: some samples, such as those after the lead-in, or another shape."""
    if name != "slice":
        order = parameters["permutation"] if name == "transpose" else ()
        longer = [axis for axis in order if history.shape[axis] > 1]
        if math.prod(shape) != size_of(history) or longer != sorted(longer):
            return None
        return replace(history, shape=shape)
    starts, lengths = parameters["start_indices"], np.subtract(parameters["limit_indices"], parameters["start_indices"])
    # The numbers lie one after the other where all axes after the first that is not of length one are whole.
    cut = int(np.argmax(lengths != 1)) + 1 if (lengths != 1).any() else len(lengths)
    if tuple(lengths[cut:]) != history.shape[cut:] or set(parameters["strides"] or (1,)) != {1}:
        return None
    return replace(history, shape=shape, first=history.first + int(np.ravel_multi_index(starts, history.shape)))


def gathered(primitive: Any, parameters: dict[str, Any], numbers: Array, indices: np.ndarray) -> Array:
    """Choose numbers by known indices: JAX says which, by choosing among their places."""
    places = np.asarray(primitive.bind(np.arange(numbers.size).reshape(numbers.shape), indices, **parameters))
    if places.min(initial=0) < 0 or places.max(initial=0) >= numbers.size:
        raise UntranslatableError("indices beyond an array")
    return array_of(numbers.reshape(-1)[places.reshape(-1)], places.shape)


def computed_now(primitive: Any, parameters: dict[str, Any], taken: Sequence[Any]) -> list[Value]:
    """Do an operation on numbers that are known."""
    arrays = _values(primitive, parameters, [known_values(x) for x in taken])
    return [Shared(x) for x in arrays] if any(isinstance(x, Shared) for x in taken) else list(arrays)


def _values(primitive: Any, parameters: dict[str, Any], taken: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The same by NumPy where it has the operation: JAX would compile each for itself."""
    name = primitive.name
    if name in ARRANGEMENT:
        return [np.asarray(ARRANGEMENT[name](parameters, *taken), dtype=taken[0].dtype)]
    if name in IN_NUMPY:
        return [np.asarray(IN_NUMPY[name](parameters, *taken))]
    found = primitive.bind(*taken, **parameters)
    return [np.asarray(x) for x in (found if primitive.multiple_results else [found])]
