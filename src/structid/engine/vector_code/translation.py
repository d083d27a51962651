"""From a jaxpr, JAX's list of primitive operations on one run, to vector code for many."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jax.extend.core import Literal

from structid.engine.matrices.block_sparse import AXES
from structid.engine.vector_code.operations import Function, constants_and_carried
from structid.engine.vector_code.primitives import ARITHMETIC, ARRANGEMENT, REDUCTION, Array, UntranslatableError
from structid.engine.vector_code.registers import Number
from structid.engine.vector_code.shared_numbers import SharedNumbers
from structid.engine.vector_code.slots import Slots, Table
from structid.engine.vector_code.sparse_code import written
from structid.engine.vector_code.values import (
    MOVES,
    History,
    InMemory,
    Shared,
    SharedRow,
    Value,
    array_of,
    computed_now,
    flattened,
    gathered,
    is_known,
    known_values,
    moved,
    size_of,
)
from structid.engine.vector_code.vector_code import VectorCode

LARGEST_ARRAY = 4096
"""Largest array whose numbers are operated on one by one."""

LARGEST_ROW = 256
"""Largest part of a history whose numbers are operated on one by one, and largest row of a shared array that is loaded whole."""

LARGEST_SHARED_ROW = 2048
"""Largest row of a shared array whose numbers are operated on one by one: hundreds of components of three channels."""

ALONG_HISTORIES = {"add", "sub", "mul", "div", "neg", "abs", "sqrt", "exp", "log", "square", "integer_pow"}
"""Arithmetic that is done in a loop where it takes a whole history."""

LONGEST_UNROLLED = 16
"""Passes of a loop that stays what it is in the text; those of longer ones are given to the kernel."""


class Translator:
    """Writes functions of one run as vector code."""

    def __init__(self, code: VectorCode) -> None:
        self.code, self.shared = code, SharedNumbers(code)
        self.kept: list[int] = []
        self._depth = 0

    def function(
        self, function: Function, arguments: Sequence[Value], given: Mapping[Any, Value] | None = None
    ) -> list[Value]:
        """Write a function."""
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
            made = self._operation(equation.primitive, equation.params, taken, equation.outvars[0].aval.shape)
            known.update(zip(equation.outvars, made, strict=True))
        return [read(atom) for atom in function.outvars]

    def _operation(
        self, primitive: Any, parameters: dict[str, Any], taken: list[Value], shape: tuple[int, ...]
    ) -> list[Value]:
        """Results of an operation; `shape` is that of the first."""
        name = primitive.name
        if all(is_known(x) for x in taken):
            return computed_now(primitive, parameters, taken)
        if name == "scan":
            return self._loop(parameters, taken)
        if name == "while":
            return self._while(parameters, taken)
        if primitive in AXES:
            return [written(primitive, self.code, self.shared, parameters, taken, self.numbers, shape)]
        if isinstance(taken[0], History) and name in MOVES:
            found = moved(name, parameters, taken[0], shape)
            if found is not None:
                return [found]
        if not self._depth and any(isinstance(x, History) and size_of(x) > LONGEST_UNROLLED for x in taken):
            # An array that is repeated along another axis has no number for each number of the result.
            if name in ALONG_HISTORIES and {size_of(x) for x in taken} <= {1, math.prod(shape)}:
                return [self._number_by_number(ARITHMETIC[name], parameters, taken, shape)]
            if name == "reduce_sum" and isinstance(taken[0], History) and math.prod(shape) == 1:
                return [self._sum_of_history(taken[0], shape)]
        if name == "gather" and is_known(taken[1]):
            return [gathered(primitive, parameters, self.numbers(taken[0]), known_values(taken[1]))]
        arrays = [self.numbers(x) for x in taken]
        if name in ARITHMETIC:
            return [_elementwise(ARITHMETIC[name], self.code, parameters, arrays)]
        if name in ARRANGEMENT:
            return [np.asarray(ARRANGEMENT[name](parameters, *arrays), dtype=object)]
        if name in REDUCTION:
            return [np.asarray(REDUCTION[name](self.code, parameters, *arrays), dtype=object)]
        raise UntranslatableError(f"the operation '{name}'")

    def numbers(self, value: Value) -> Array:
        """Numbers of an array, to be operated on one by one."""
        if isinstance(value, History):
            if size_of(value) > LARGEST_ROW:
                raise UntranslatableError("arithmetic on a whole history")
            return self._row_of_history(replace(value, shape=(1, *value.shape)), "0").reshape(value.shape)
        if isinstance(value, np.ndarray):
            return value
        if isinstance(value, InMemory):
            places = [self.code.address(value.place, i, lanes=True) for i in range(size_of(value))]
            return array_of([self.code.load(place, lanes=True) for place in places], value.shape)
        if isinstance(value, SharedRow):
            if size_of(value) > LARGEST_SHARED_ROW:
                raise UntranslatableError("arithmetic on a long row of an array")
            return array_of(self.shared.at(value.place, size_of(value)), value.shape)
        if value.values.size > LARGEST_ARRAY or value.values.dtype not in (np.float64, np.bool_):
            raise UntranslatableError(f"an array of {value.values.size} numbers of kind {value.values.dtype}")
        found = self.shared.loaded(value.values)
        if value.values.dtype == np.bool_:
            found = [self.code.operation("fcmp une", [number, 0.0], result="i1") for number in found]
        return array_of(found, value.values.shape)

    # --- loops --------------------------------------------------------------------------------------------------

    def _loop(self, parameters: dict[str, Any], taken: list[Value]) -> list[Value]:
        """A loop over time, or one inside its step, such as that over the substeps of a sample."""
        if parameters["reverse"]:
            raise UntranslatableError("a loop that runs backwards")
        constants, carried = constants_and_carried(parameters)
        length = parameters["length"]
        fixed, start, series = taken[:constants], taken[constants : constants + carried], taken[constants + carried :]
        fixed = [
            x if isinstance(x, (History, InMemory)) or (is_known(x) and size_of(x) > LARGEST_ARRAY) else self.numbers(x)
            for x in fixed
        ]
        state = [Slots(self.code, self.numbers(x)) for x in start]
        tables = [self._series(x) for x in series]
        kept = [self._history(length, aval.shape) for aval in parameters["jaxpr"].out_avals[carried:]]
        of_a_pass = Function.inlined(parameters["jaxpr"])
        self._depth += 1
        with self.code.loop(self._passes(length, series)) as at:
            rows = [table(at) for table in tables]
            made = self.function(of_a_pass, [*fixed, *(s.read() for s in state), *rows])
            for history, value in zip(kept, made[carried:], strict=True):
                self._keep(history, at, self.numbers(value))
            for slots, value in zip(state, made[:carried], strict=True):
                slots.write(self.numbers(value))
        self._depth -= 1
        return [*(s.read() for s in state), *kept]

    def _while(self, parameters: dict[str, Any], taken: list[Value]) -> list[Value]:
        """A loop that each run leaves when it is done: it goes on for all lanes while one needs it, and changes no other lane."""
        of_condition, of_body = parameters["cond_nconsts"], parameters["body_nconsts"]
        given, fixed = taken[:of_condition], taken[of_condition : of_condition + of_body]
        state = [Slots(self.code, self.numbers(x)) for x in taken[of_condition + of_body :]]
        condition, body = (Function.inlined(parameters[name]) for name in ("cond_jaxpr", "body_jaxpr"))
        self._depth += 1
        with self.code.loop_while() as go_on:
            before = [s.read() for s in state]
            (holds,) = self.function(condition, [*given, *before])
            goes_on = self.numbers(holds)
            go_on(goes_on.item())
            made = self.function(body, [*fixed, *before])
            for slots, old, new in zip(state, before, made, strict=True):
                slots.write(_elementwise(ARITHMETIC["select_n"], self.code, {}, [goes_on, old, self.numbers(new)]))
        self._depth -= 1
        return [s.read() for s in state]

    def _passes(self, length: int, series: Sequence[Value]) -> int | str:
        """Number of passes of a loop: other records, and other designs, need no other code.

        Short loops over short rows are unrolled, so it stays in the text.
        """
        long_rows = any(size_of(x) > LARGEST_ROW * length for x in series)
        return self.shared.length(length) if length > LONGEST_UNROLLED or long_rows else length

    def _series(self, value: Value) -> Callable[[str], Value]:
        """Return the function that gives a row of what a loop goes through."""
        if isinstance(value, History):
            return lambda at: self._row_of_history(value, at)
        if isinstance(value, np.ndarray) and value.dtype == object:
            if value.size > LARGEST_ARRAY:
                raise UntranslatableError(f"a loop through {value.size} numbers of each run")
            return Table(self.code, value).row
        if isinstance(value, InMemory):
            raise UntranslatableError(f"a loop through {size_of(value)} numbers of each run")
        if isinstance(value, SharedRow):
            first, shape = value.place, value.shape[1:]
        else:
            values = value.values if isinstance(value, Shared) else value
            if values.dtype != np.float64:
                raise UntranslatableError(f"a loop through numbers of kind {values.dtype}")
            first, shape = self.shared.place(values), values.shape[1:]

        size = math.prod(shape)
        each: int | str = self.shared.length(size) if size > LARGEST_ROW else size

        def row(at: str) -> Value:
            place = self.code.whole("add", first, self.code.whole("mul", at, each))
            found = SharedRow(place, shape)
            return found if size > LARGEST_ROW else self.numbers(found)

        return row

    # --- histories ----------------------------------------------------------------------------------------------

    def _number_by_number(
        self, function: Callable[..., Number], parameters: dict[str, Any], taken: list[Value], shape: tuple[int, ...]
    ) -> History:
        """Arithmetic on whole histories, in a loop over their numbers."""
        size = math.prod(shape)
        series = [self._series(flattened(x)) if size_of(x) > 1 else None for x in taken]
        fixed = [self.numbers(x).reshape(-1)[0] if row is None else None for x, row in zip(taken, series, strict=True)]
        found = self._history(size, ())
        with self.code.loop(self.shared.length(size)) as at:
            rows = [one if row is None else self.numbers(row(at))[()] for one, row in zip(fixed, series, strict=True)]
            self._keep(found, at, array_of([function(self.code, parameters, *rows)], ()))
        return replace(found, shape=shape)

    def _sum_of_history(self, history: History, shape: tuple[int, ...]) -> Array:
        """Sum of all numbers of a history."""
        total, number = Slots(self.code, array_of([0.0], ())), self._series(flattened(history))
        with self.code.loop(self.shared.length(size_of(history))) as at:
            both = [total.read()[()], self.numbers(number(at))[()]]
            total.write(array_of([ARITHMETIC["add"](self.code, {}, *both)], ()))
        return total.read().reshape(shape)

    def _history(self, length: int, shape: tuple[int, ...]) -> History:
        if self._depth:
            raise UntranslatableError("a loop within the loop that keeps values")
        found = History(len(self.kept), (length, *shape))
        self.kept.append(size_of(found))
        return found

    def _places(self, history: History, at: str) -> list[str]:
        """Addresses of the numbers of one sample."""
        code, count = self.code, int(np.prod(history.shape[1:]))
        row = code.whole("add", code.whole("mul", at, count), history.first)
        first = code.whole("add", code.whole("mul", row, history.each), history.across)
        places = [code.whole("add", first, code.whole("mul", history.each, index)) for index in range(count)]
        return [code.address(history.base, place) for place in places]

    def _keep(self, history: History, at: str, numbers: Array) -> None:
        for number, place in zip(numbers.reshape(-1), self._places(history, at), strict=True):
            self.code.store(number, place, lanes=True)

    def _row_of_history(self, history: History, at: str) -> Array:
        return array_of([self.code.load(p, lanes=True) for p in self._places(history, at)], history.shape[1:])


def _elementwise(
    function: Callable[..., Number], code: VectorCode, parameters: dict[str, Any], taken: Sequence[Array]
) -> Array:
    spread = np.broadcast_arrays(*taken)
    found = np.empty(spread[0].shape, dtype=object)
    for place in np.ndindex(found.shape):
        found[place] = function(code, parameters, *(x[place] for x in spread))
    return found
