"""Translation of a jaxpr, JAX's list of primitive operations for one run, to vector code for many runs."""

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
from structid.engine.vector_code.slots import LookupTable, Slots
from structid.engine.vector_code.sparse_code import written
from structid.engine.vector_code.values import (
    MOVES,
    History,
    InThreadMemory,
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
"""Largest array for which operations are written element by element."""

LARGEST_ROW = 256
"""Largest part of a history for which operations are written element by element; also the largest row of a shared array
that is loaded into registers."""

LARGEST_SHARED_ROW = 2048
"""Largest row of a shared array for which operations are written element by element. It allows hundreds of components
with 3 channels."""

ALONG_HISTORIES = {"add", "sub", "mul", "div", "neg", "abs", "sqrt", "exp", "log", "square", "integer_pow"}
"""Arithmetic that becomes a loop if an operand is a whole history."""

LONGEST_UNROLLED = 16
"""Largest number of loop iterations that is a constant of the LLVM code; a larger number is passed to the kernel."""


class Translator:
    """Translator of functions of one run to vector code."""

    def __init__(self, code: VectorCode) -> None:
        self.code, self.shared = code, SharedNumbers(code)
        self.kept: list[int] = []
        self._depth = 0

    def function(
        self, function: Function, arguments: Sequence[Value], given: Mapping[Any, Value] | None = None
    ) -> list[Value]:
        """Write all operations of a function."""
        consts = [c if isinstance(c, (Shared, History)) else Shared(np.asarray(c)) for c in function.consts]
        values: dict[Any, Value] = dict(
            zip([*function.constvars, *function.invars], [*consts, *arguments], strict=True)
        )
        values.update(given or {})

        def read(atom: Any) -> Value:
            return np.asarray(atom.val) if isinstance(atom, Literal) else values[atom]

        # Going backwards omits operations that are needed only for given values.
        required, steps = {v for v in function.outvars if not isinstance(v, Literal)}, []
        for equation in reversed(function.eqns):
            if not values.keys() >= required.intersection(equation.outvars):
                steps.append(equation)
                required.update(atom for atom in equation.invars if not isinstance(atom, Literal))
        for equation in reversed(steps):
            operands = [read(atom) for atom in equation.invars]
            results = self._operation(equation.primitive, equation.params, operands, equation.outvars[0].aval.shape)
            values.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in function.outvars]

    def _operation(
        self, primitive: Any, parameters: dict[str, Any], operands: list[Value], shape: tuple[int, ...]
    ) -> list[Value]:
        """Return the results of an operation; `shape` is the shape of the first result."""
        name = primitive.name
        if all(is_known(x) for x in operands):
            return computed_now(primitive, parameters, operands)
        if name == "scan":
            return self._loop(parameters, operands)
        if name == "while":
            return self._while(parameters, operands)
        if primitive in AXES:
            return [written(primitive, self.code, self.shared, parameters, operands, self.numbers, shape)]
        if isinstance(operands[0], History) and name in MOVES:
            result = moved(name, parameters, operands[0], shape)
            if result is not None:
                return [result]
        if not self._depth and any(isinstance(x, History) and size_of(x) > LONGEST_UNROLLED for x in operands):
            # This excludes arrays that are repeated along another axis: they have fewer numbers than the result.
            if name in ALONG_HISTORIES and {size_of(x) for x in operands} <= {1, math.prod(shape)}:
                return [self._number_by_number(ARITHMETIC[name], parameters, operands, shape)]
            if name == "reduce_sum" and isinstance(operands[0], History) and math.prod(shape) == 1:
                return [self._sum_of_history(operands[0], shape)]
        if name == "gather" and is_known(operands[1]):
            return [gathered(primitive, parameters, self.numbers(operands[0]), known_values(operands[1]))]
        arrays = [self.numbers(x) for x in operands]
        if name in ARITHMETIC:
            return [_elementwise(ARITHMETIC[name], self.code, parameters, arrays)]
        if name in ARRANGEMENT:
            return [np.asarray(ARRANGEMENT[name](parameters, *arrays), dtype=object)]
        if name in REDUCTION:
            return [np.asarray(REDUCTION[name](self.code, parameters, *arrays), dtype=object)]
        raise UntranslatableError(f"the operation '{name}'")

    def numbers(self, value: Value) -> Array:
        """Return an array as constants and registers, for elementwise operations."""
        if isinstance(value, History):
            if size_of(value) > LARGEST_ROW:
                raise UntranslatableError("arithmetic on a whole history")
            return self._row_of_history(replace(value, shape=(1, *value.shape)), "0").reshape(value.shape)
        if isinstance(value, np.ndarray):
            return value
        if isinstance(value, InThreadMemory):
            places = [self.code.address(value.place, i, lanes=True) for i in range(size_of(value))]
            return array_of([self.code.load(address, lanes=True) for address in places], value.shape)
        if isinstance(value, SharedRow):
            if size_of(value) > LARGEST_SHARED_ROW:
                raise UntranslatableError(f"arithmetic on an array row of more than {LARGEST_SHARED_ROW} numbers")
            return array_of(self.shared.at(value.place, size_of(value)), value.shape)
        if value.values.size > LARGEST_ARRAY or value.values.dtype not in (np.float64, np.bool_):
            raise UntranslatableError(f"operations on {value.values.size} numbers of type {value.values.dtype}")
        result = self.shared.loaded(value.values)
        if value.values.dtype == np.bool_:
            result = [self.code.operation("fcmp une", [number, 0.0], result="i1") for number in result]
        return array_of(result, value.values.shape)

    # --- loops --------------------------------------------------------------------------------------------------

    def _loop(self, parameters: dict[str, Any], taken: list[Value]) -> list[Value]:
        """Write a loop over time, or a loop inside its step, such as the loop over the substeps of a sample."""
        if parameters["reverse"]:
            raise UntranslatableError("a loop that runs backwards")
        constants, carried = constants_and_carried(parameters)
        length = parameters["length"]
        fixed, start, series = taken[:constants], taken[constants : constants + carried], taken[constants + carried :]
        fixed = [
            x
            if isinstance(x, (History, InThreadMemory)) or (is_known(x) and size_of(x) > LARGEST_ARRAY)
            else self.numbers(x)
            for x in fixed
        ]
        state = [Slots(self.code, self.numbers(x)) for x in start]
        tables = [self._series(x) for x in series]
        kept = [self._history(length, aval.shape) for aval in parameters["jaxpr"].out_avals[carried:]]
        of_a_pass = Function.inlined(parameters["jaxpr"])
        self._depth += 1
        with self.code.loop(self._passes(length, series)) as at:
            rows = [table(at) for table in tables]
            results = self.function(of_a_pass, [*fixed, *(s.read() for s in state), *rows])
            for history, value in zip(kept, results[carried:], strict=True):
                self._keep(history, at, self.numbers(value))
            for slots, value in zip(state, results[:carried], strict=True):
                slots.write(self.numbers(value))
        self._depth -= 1
        return [*(s.read() for s in state), *kept]

    def _while(self, parameters: dict[str, Any], taken: list[Value]) -> list[Value]:
        """Write a loop that ends separately for each run; finished lanes stay unchanged until all lanes finish."""
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
            results = self.function(body, [*fixed, *before])
            for slots, old, new in zip(state, before, results, strict=True):
                slots.write(_elementwise(ARITHMETIC["select_n"], self.code, {}, [goes_on, old, self.numbers(new)]))
        self._depth -= 1
        return [s.read() for s in state]

    def _passes(self, length: int, series: Sequence[Value]) -> int | str:
        """Return the number of iterations of a loop: an integer, or the name of a number that is passed to the kernel.

        A number passed to the kernel allows other records and designs without a new compilation. For short loops over
        short rows the number is a constant of the LLVM code.
        """
        long_rows = any(size_of(x) > LARGEST_ROW * length for x in series)
        return self.shared.length(length) if length > LONGEST_UNROLLED or long_rows else length

    def _series(self, value: Value) -> Callable[[str], Value]:
        """Return the function that loads a row of the loop's input."""
        if isinstance(value, History):
            return lambda at: self._row_of_history(value, at)
        if isinstance(value, np.ndarray) and value.dtype == object:
            if value.size > LARGEST_ARRAY:
                raise UntranslatableError(f"a loop over an array of {value.size} numbers per run")
            return LookupTable(self.code, value).row
        if isinstance(value, InThreadMemory):
            raise UntranslatableError(f"a loop over an array of {size_of(value)} numbers per run")
        if isinstance(value, SharedRow):
            first, shape = value.place, value.shape[1:]
        else:
            values = value.values if isinstance(value, Shared) else value
            if values.dtype != np.float64:
                raise UntranslatableError(f"a loop over an array of type {values.dtype}")
            first, shape = self.shared.place(values), values.shape[1:]

        size = math.prod(shape)
        each: int | str = self.shared.length(size) if size > LARGEST_ROW else size

        def row(at: str) -> Value:
            address = self.code.whole("add", first, self.code.whole("mul", at, each))
            result = SharedRow(address, shape)
            return result if size > LARGEST_ROW else self.numbers(result)

        return row

    # --- histories ----------------------------------------------------------------------------------------------

    def _number_by_number(
        self, function: Callable[..., Number], parameters: dict[str, Any], taken: list[Value], shape: tuple[int, ...]
    ) -> History:
        """Write arithmetic on whole histories as a loop over their numbers."""
        size = math.prod(shape)
        series = [self._series(flattened(x)) if size_of(x) > 1 else None for x in taken]
        fixed = [self.numbers(x).reshape(-1)[0] if row is None else None for x, row in zip(taken, series, strict=True)]
        result = self._history(size, ())
        with self.code.loop(self.shared.length(size)) as at:
            rows = [one if row is None else self.numbers(row(at))[()] for one, row in zip(fixed, series, strict=True)]
            self._keep(result, at, array_of([function(self.code, parameters, *rows)], ()))
        return replace(result, shape=shape)

    def _sum_of_history(self, history: History, shape: tuple[int, ...]) -> Array:
        """Return the sum of all numbers of a history."""
        total, number = Slots(self.code, array_of([0.0], ())), self._series(flattened(history))
        with self.code.loop(self.shared.length(size_of(history))) as at:
            both = [total.read()[()], self.numbers(number(at))[()]]
            total.write(array_of([ARITHMETIC["add"](self.code, {}, *both)], ()))
        return total.read().reshape(shape)

    def _history(self, length: int, shape: tuple[int, ...]) -> History:
        if self._depth:
            raise UntranslatableError("a nested loop that stores a history")
        result = History(len(self.kept), (length, *shape))
        self.kept.append(size_of(result))
        return result

    def _places(self, history: History, at: str) -> list[str]:
        """Return the addresses of the numbers of one sample."""
        code, count = self.code, int(np.prod(history.shape[1:]))
        row = code.whole("add", code.whole("mul", at, count), history.first)
        first = code.whole("add", code.whole("mul", row, history.each), history.across)
        places = [code.whole("add", first, code.whole("mul", history.each, index)) for index in range(count)]
        return [code.address(history.base, position) for position in places]

    def _keep(self, history: History, at: str, numbers: Array) -> None:
        for number, address in zip(numbers.reshape(-1), self._places(history, at), strict=True):
            self.code.store(number, address, lanes=True)

    def _row_of_history(self, history: History, at: str) -> Array:
        return array_of([self.code.load(p, lanes=True) for p in self._places(history, at)], history.shape[1:])


def _elementwise(
    function: Callable[..., Number], code: VectorCode, parameters: dict[str, Any], taken: Sequence[Array]
) -> Array:
    spread = np.broadcast_arrays(*taken)
    result = np.empty(spread[0].shape, dtype=object)
    for index in np.ndindex(result.shape):
        result[index] = function(code, parameters, *(x[index] for x in spread))
    return result
