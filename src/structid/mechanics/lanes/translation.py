"""From a jaxpr, JAX's list of primitive operations on one run, to vector code for many."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jax.extend.core import Literal

from structid.mechanics.lanes.operations import Function
from structid.mechanics.lanes.primitives import ARITHMETIC, ARRANGEMENT, REDUCTION, Array, UntranslatableError
from structid.mechanics.lanes.shared_numbers import SharedNumbers
from structid.mechanics.lanes.vector_code import Number, Register, VectorCode

IN_NUMPY: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "sqrt": np.sqrt,
    "abs": np.abs, "exp": np.exp, "log": np.log, "gt": np.greater, "lt": np.less,
}  # fmt: skip
"""Operations that NumPy does as JAX does, on numbers of one kind."""

LARGEST_ARRAY = 4096
"""Largest array whose numbers are operated on one by one."""


LARGEST_ROW = 256
"""Largest part of a history, or row of a shared array, whose numbers are operated on one by one."""

LONGEST_UNROLLED = 16
"""Passes of a loop that stays what it is in the text; those of longer ones are given to the kernel."""

MOVES = {"slice", "squeeze", "reshape"}
"""Operations on a whole history that only say where its numbers are."""


@dataclass(frozen=True)
class Shared:
    """An array that all runs share. Its numbers are not in the text: other numbers need no other code.

    Parameters
    ----------
    values : ndarray
        The numbers.
    """

    values: np.ndarray


@dataclass(frozen=True)
class SharedRow:
    """A row of an array that all runs share, such as one that a loop inside a loop goes through.

    Parameters
    ----------
    place : str
        Name of the place of its first number.
    shape : tuple of int
        Its shape.
    """

    place: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class History:
    """What a loop over time kept, or signals that it goes through: rows of a buffer, each with a number for every run.

    Parameters
    ----------
    first : int
        Number of its first row.
    shape : tuple of int
        (time, …).
    given : bool
        Whether it is among the signals that the runs are given, and not among the histories that they make.
    """

    first: int
    shape: tuple[int, ...]
    given: bool = False


Value = np.ndarray | Shared | SharedRow | History
"""Constants that stand in the text, numbers shared by all runs or a row of them, numbers in registers, or a history."""


class Translator:
    """Writes functions of one run as vector code.

    Parameters
    ----------
    code : VectorCode
        Where they are written.
    signals : int
        Rows of the buffer of signals.

    Attributes
    ----------
    rows : int
        Rows of the buffer of histories taken so far.
    shared : SharedNumbers
        Numbers that all runs share.
    block, column : str
        Names of the number of the block that is under way, and of that of its first run.
    """

    def __init__(self, code: VectorCode, signals: int = 0) -> None:
        self.code, self.rows, self._signals = code, 0, signals
        self.shared = SharedNumbers(code)
        self._depth = 0
        self.block = self.column = "0"

    def function(
        self, function: Function, arguments: Sequence[Value], given: Mapping[Any, Value] | None = None
    ) -> list[Value]:
        """Write a function.

        Parameters
        ----------
        function : Function
            The function.
        arguments : sequence of Value
            What it is given.
        given : mapping of Var to Value, optional
            Results that are there already.

        Returns
        -------
        list of Value
            What it returns.

        Raises
        ------
        UntranslatableError
            If something in it has no vector code.
        """
        consts = [c if isinstance(c, (Shared, History)) else Shared(np.asarray(c)) for c in function.consts]
        known: dict[Any, Value] = dict(zip([*function.constvars, *function.invars], [*consts, *arguments], strict=True))
        known.update(given or {})

        def read(atom: Any) -> Value:
            return np.asarray(atom.val) if isinstance(atom, Literal) else known[atom]

        # Backwards, so that nothing is written that only leads to what is given.
        wanted, steps = {v for v in function.outvars if not isinstance(v, Literal)}, []
        for equation in reversed(function.eqns):
            if not known.keys() >= wanted.intersection(equation.outvars):
                steps.append(equation)
                wanted.update(atom for atom in equation.invars if not isinstance(atom, Literal))
        for equation in reversed(steps):
            taken = [read(atom) for atom in equation.invars]
            made = self._operation(equation.primitive, equation.params, taken)
            known.update(zip(equation.outvars, made, strict=True))
        return [read(atom) for atom in function.outvars]

    def _operation(self, primitive: Any, parameters: dict[str, Any], taken: list[Value]) -> list[Value]:
        name = primitive.name
        if all(_is_known(x) for x in taken):
            return _computed_now(primitive, parameters, taken)
        if name == "scan":
            return self._loop(parameters, taken)
        if isinstance(taken[0], History) and name in MOVES:
            return [_part_of_history(name, parameters, taken[0])]
        if name == "gather" and _is_known(taken[1]):
            return [_gathered(primitive, parameters, self.numbers(taken[0]), _known_values(taken[1]))]
        arrays = [self.numbers(x) for x in taken]
        if name in ARITHMETIC:
            return [_elementwise(ARITHMETIC[name], self.code, parameters, arrays)]
        if name in ARRANGEMENT:
            return [np.asarray(ARRANGEMENT[name](parameters, *arrays), dtype=object)]
        if name in REDUCTION:
            return [np.asarray(REDUCTION[name](self.code, parameters, *arrays), dtype=object)]
        raise UntranslatableError(f"the operation '{name}'")

    def numbers(self, value: Value) -> Array:
        """Numbers of an array, to be operated on one by one.

        Parameters
        ----------
        value : Value
            The array.

        Returns
        -------
        ndarray of Number
            Those that all runs share are loaded once.
        """
        if isinstance(value, History):
            if _size(value) > LARGEST_ROW:
                raise UntranslatableError("arithmetic on a whole history")
            return self._row_of_history(History(value.first, (1, *value.shape), value.given), "0").reshape(value.shape)
        if isinstance(value, np.ndarray):
            return value
        if isinstance(value, SharedRow):
            if _size(value) > LARGEST_ROW:
                raise UntranslatableError("arithmetic on a long row of an array")
            return _array(self.shared.at(value.place, _size(value)), value.shape)
        if value.values.size > LARGEST_ARRAY or value.values.dtype not in (np.float64, np.bool_):
            raise UntranslatableError(f"an array of {value.values.size} numbers of kind {value.values.dtype}")
        found = self.shared.loaded(value.values)
        if value.values.dtype == np.bool_:
            found = [self.code.operation("fcmp une", [number, 0.0], result="i1") for number in found]
        return _array(found, value.values.shape)

    # --- loops --------------------------------------------------------------------------------------------------

    def _loop(self, parameters: dict[str, Any], taken: list[Value]) -> list[Value]:
        """A loop over time, or one inside its step, such as that over the substeps of a sample."""
        if parameters["reverse"]:
            raise UntranslatableError("a loop that runs backwards")
        constants, carried = _constants_and_carried(parameters)
        length = parameters["length"]
        fixed, start, series = taken[:constants], taken[constants : constants + carried], taken[constants + carried :]
        fixed = [
            x if isinstance(x, History) or (_is_known(x) and _size(x) > LARGEST_ARRAY) else self.numbers(x)
            for x in fixed
        ]
        state = [_Slots(self.code, self.numbers(x)) for x in start]
        tables = [self._series(x) for x in series]
        kept = [self._history(length, aval.shape) for aval in parameters["jaxpr"].out_avals[carried:]]
        of_a_pass = Function.inlined(parameters["jaxpr"])
        self._depth += 1
        # Other records need no other code. Short loops are unrolled, so their length stays in the text.
        with self.code.loop(self.shared.length(length) if length > LONGEST_UNROLLED else length) as at:
            rows = [table(at) for table in tables]
            made = self.function(of_a_pass, [*fixed, *(s.read() for s in state), *rows])
            for history, value in zip(kept, made[carried:], strict=True):
                self._keep(history, at, self.numbers(value))
            for slots, value in zip(state, made[:carried], strict=True):
                slots.write(self.numbers(value))
        self._depth -= 1
        return [*(s.read() for s in state), *kept]

    def _series(self, value: Value) -> Callable[[str], Value]:
        """Return the function that gives a row of what a loop goes through."""
        if isinstance(value, History):
            return lambda at: self._row_of_history(value, at)
        if isinstance(value, np.ndarray) and value.dtype == object:
            if value.size > LARGEST_ARRAY:
                raise UntranslatableError(f"a loop through {value.size} numbers of each run")
            return _Table(self.code, value).row
        if isinstance(value, SharedRow):
            first, shape = value.place, value.shape[1:]
        else:
            values = value.values if isinstance(value, Shared) else value
            if values.dtype != np.float64:
                raise UntranslatableError(f"a loop through numbers of kind {values.dtype}")
            first, shape = self.shared.place(values), values.shape[1:]

        def row(at: str) -> Value:
            place = self.code.whole("add", first, self.code.whole("mul", at, math.prod(shape)))
            found = SharedRow(place, shape)
            return found if _size(found) > LARGEST_ROW else self.numbers(found)

        return row

    def _history(self, length: int, shape: tuple[int, ...]) -> History:
        if self._depth:
            raise UntranslatableError("a loop within the loop that keeps values")
        found = History(self.rows, (length, *shape))
        self.rows += int(np.prod(found.shape))
        return found

    def _places(self, history: History, at: str) -> list[str]:
        """Addresses of the numbers of one sample."""
        code, count = self.code, int(np.prod(history.shape[1:]))
        row = code.whole("add", code.whole("mul", at, count), history.first)
        if history.given:
            before = code.whole("mul", self.block, self.shared.length(self._signals))
            first, each = code.whole("mul", code.whole("add", before, row), code.width), str(code.width)
        else:
            first, each = code.whole("add", code.whole("mul", row, "%stride"), self.column), "%stride"
        base = "%signals" if history.given else "%histories"
        return [code.address(base, code.whole("add", first, code.whole("mul", each, i))) for i in range(count)]

    def _keep(self, history: History, at: str, numbers: Array) -> None:
        for number, place in zip(numbers.reshape(-1), self._places(history, at), strict=True):
            self.code.store(number, place, lanes=True)

    def _row_of_history(self, history: History, at: str) -> Array:
        return _array([self.code.load(p, lanes=True) for p in self._places(history, at)], history.shape[1:])


def _constants_and_carried(parameters: dict[str, Any]) -> tuple[int, int]:
    """How many of the arrays that a loop takes stay as they are, and how many change from pass to pass."""
    if "num_consts" in parameters:
        return parameters["num_consts"], parameters["num_carry"]
    constants, carried, _ = parameters["ft_in"].unpack()  # from JAX 0.11 on
    return len(constants), len(carried)


def _is_known(value: Value) -> bool:
    """Whether its numbers are known before the code runs."""
    return isinstance(value, Shared) or (isinstance(value, np.ndarray) and value.dtype != object)


def _size(value: Value) -> int:
    return value.values.size if isinstance(value, Shared) else int(np.prod(value.shape))


def _known_values(value: Any) -> np.ndarray:
    return value.values if isinstance(value, Shared) else value


def _gathered(primitive: Any, parameters: dict[str, Any], numbers: Array, indices: np.ndarray) -> Array:
    """Numbers that known indices choose: JAX says which, by choosing among their places."""
    places = np.asarray(primitive.bind(np.arange(numbers.size).reshape(numbers.shape), indices, **parameters))
    if places.min(initial=0) < 0 or places.max(initial=0) >= numbers.size:
        raise UntranslatableError("indices beyond an array")
    return _array(numbers.reshape(-1)[places.reshape(-1)], places.shape)


def _computed_now(primitive: Any, parameters: dict[str, Any], taken: Sequence[Any]) -> list[Value]:
    """Results of an operation on numbers that are known: constants if all of them are."""
    arrays = _values(primitive, parameters, [_known_values(x) for x in taken])
    return [Shared(x) for x in arrays] if any(isinstance(x, Shared) for x in taken) else list(arrays)


def _values(primitive: Any, parameters: dict[str, Any], taken: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The same by NumPy where it has the operation: JAX would compile each for itself."""
    name = primitive.name
    if name in ARRANGEMENT:
        return [np.asarray(ARRANGEMENT[name](parameters, *taken), dtype=taken[0].dtype)]
    if name in IN_NUMPY:
        return [np.asarray(IN_NUMPY[name](*taken))]
    found = primitive.bind(*taken, **parameters)
    return [np.asarray(x) for x in (found if primitive.multiple_results else [found])]


def _part_of_history(name: str, parameters: dict[str, Any], history: History) -> History:
    """Some samples of a history, such as those after the lead-in, or the same numbers in another shape."""
    if name != "slice":
        shape = parameters["new_sizes"] if name == "reshape" else None
        ones = parameters.get("dimensions", ())
        return History(history.first, shape or tuple(np.delete(history.shape, ones)), history.given)
    starts, lengths = parameters["start_indices"], np.subtract(parameters["limit_indices"], parameters["start_indices"])
    # The numbers lie one after the other where all axes after the first that is not of length one are whole.
    cut = int(np.argmax(lengths != 1)) + 1 if (lengths != 1).any() else len(lengths)
    if tuple(lengths[cut:]) != history.shape[cut:] or set(parameters["strides"] or (1,)) != {1}:
        raise UntranslatableError("some columns of a whole history")
    first = int(np.ravel_multi_index(starts, history.shape))
    return History(history.first + first, tuple(map(int, lengths)), history.given)


def _elementwise(
    function: Callable[..., Number], code: VectorCode, parameters: dict[str, Any], taken: Sequence[Array]
) -> Array:
    spread = np.broadcast_arrays(*taken)
    found = np.empty(spread[0].shape, dtype=object)
    for place in np.ndindex(found.shape):
        found[place] = function(code, parameters, *(x[place] for x in spread))
    return found


def _array(numbers: Sequence[Number], shape: tuple[int, ...]) -> Array:
    found = np.empty(len(numbers), dtype=object)
    found[:] = numbers
    return found.reshape(shape)


class _Slots:
    """An array of numbers that changes from pass to pass of a loop, each lane with its own.

    Parameters
    ----------
    code : VectorCode
        Where it is written.
    start : ndarray of Number
        Before the first pass.
    """

    def __init__(self, code: VectorCode, start: Array) -> None:
        self._code, self._shape = code, start.shape
        self._kinds = [_kind(number) for number in start.reshape(-1)]
        self._places = [code.slot(lanes=True, kind=kind) for kind in self._kinds]
        self.write(start)

    def read(self) -> Array:
        """Load the numbers."""
        found = [self._code.load(p, lanes=True, kind=k) for p, k in zip(self._places, self._kinds, strict=True)]
        return _array(found, self._shape)

    def write(self, numbers: Array) -> None:
        """Store the numbers."""
        for number, place, kind in zip(numbers.reshape(-1), self._places, self._kinds, strict=True):
            self._code.store(number, place, lanes=True, kind=kind)


def _kind(number: Number) -> str:
    if isinstance(number, Register):
        return number.kind
    return "i1" if isinstance(number, (bool, np.bool_)) else "double"


class _Table:
    """A small array of registers whose rows a loop takes one after the other, kept in memory.

    Parameters
    ----------
    code : VectorCode
        Where it is written.
    numbers : ndarray of Number
        The array, its first axis that of the loop.
    """

    def __init__(self, code: VectorCode, numbers: Array) -> None:
        self._code, self._shape = code, numbers.shape[1:]
        flat = numbers.reshape(-1)
        self._lanes = any(isinstance(n, Register) and n.lanes for n in flat)
        self._place = code.slot(self._lanes, len(flat))
        for index, number in enumerate(flat):
            code.store(number, code.address(self._place, index, self._lanes), self._lanes)

    def row(self, at: str) -> Array:
        """Load one row."""
        code, count = self._code, int(np.prod(self._shape))
        first = code.whole("mul", at, count)
        places = [code.address(self._place, code.whole("add", first, i), self._lanes) for i in range(count)]
        return _array([code.load(place, self._lanes) for place in places], self._shape)
