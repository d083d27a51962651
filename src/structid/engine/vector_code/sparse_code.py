"""Vector code for sparse matrix products and linear solves: loops over nonzero positions, with numbers in memory."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from structid.engine.matrices.block_sparse import AXES, BlockPattern, SparseMatrix, block_solve, sparse_times
from structid.engine.vector_code.primitives import Array
from structid.engine.vector_code.registers import Number
from structid.engine.vector_code.shared_numbers import SharedNumbers
from structid.engine.vector_code.values import InThreadMemory, Shared, Value, array_of
from structid.engine.vector_code.vector_code import FLAGS, VectorCode


class _Writer:
    """Writer of vector code that loops over the positions of nonzero blocks and keeps numbers in memory."""

    def __init__(self, code: VectorCode, shared: SharedNumbers) -> None:
        self.code, self.shared = code, shared

    def table(self, places: np.ndarray) -> str:
        """Append integers to the table of shared numbers; return the register name of the first integer's position."""
        return self.shared.place(np.ascontiguousarray(places, dtype=np.int64).view(np.float64))

    def entry(self, table: str, at: str | int) -> str:
        """Load one integer of a table, and return its register name."""
        code = self.code
        address = code.address("%shared", code.whole("add", table, at))
        return code.load(address, lanes=False, kind="i64").name

    def memory(self, numbers: Sequence[Number] | int) -> str:
        """Reserve memory and return its address; `numbers` is a count, or a sequence of numbers to store."""
        if isinstance(numbers, int):
            return self.code.slot(lanes=True, count=numbers)
        address = self.code.slot(lanes=True, count=len(numbers))
        for index, number in enumerate(numbers):
            self.code.store(number, self.code.address(address, index, lanes=True), lanes=True)
        return address

    def of(self, value: Value, numbers: Any) -> str:
        """Return the address of an array in memory; copy the array to memory if necessary."""
        return value.place if isinstance(value, InThreadMemory) else self.memory(list(numbers(value).reshape(-1)))

    def load(self, base: str, at: str | int) -> Number:
        """Load a number of each lane."""
        return self.code.load(self.code.address(base, at, lanes=True), lanes=True)

    def store(self, number: Number, base: str, at: str | int) -> None:
        self.code.store(number, self.code.address(base, at, lanes=True), lanes=True)

    def block(self, base: str, place: str) -> list[Number]:
        """Load the four numbers of a block, row by row."""
        first = self.code.whole("mul", place, 4)
        return [self.load(base, self.code.whole("add", first, i)) for i in range(4)]

    def pair(self, base: str, place: str) -> list[Number]:
        """Load two numbers of a vector."""
        first = self.code.whole("mul", place, 2)
        return [self.load(base, self.code.whole("add", first, i)) for i in range(2)]

    def put(self, numbers: Sequence[Number], base: str, place: str) -> None:
        """Store a block or a pair."""
        first = self.code.whole("mul", place, len(numbers))
        for i, number in enumerate(numbers):
            self.store(number, base, self.code.whole("add", first, i))

    def sum_of_products(
        self, *pairs: tuple[Number, Number], beside: Number | None = None, sign: str = "fadd"
    ) -> Number:
        """Return Σ a b, or c ± Σ a b."""
        total: Number | None = None
        for a, b in pairs:
            product = self.code.operation(f"fmul {FLAGS}", [a, b])
            total = product if total is None else self.code.operation(f"fadd {FLAGS}", [total, product])
        assert total is not None
        return total if beside is None else self.code.operation(f"{sign} {FLAGS}", [beside, total])

    def block_times_block(self, a: list[Number], b: list[Number], beside: list[Number] | None = None) -> list[Number]:
        """Return A B, or C − A B."""
        return [
            self.sum_of_products(
                (a[2 * i], b[j]),
                (a[2 * i + 1], b[2 + j]),
                beside=None if beside is None else beside[2 * i + j],
                sign="fsub",
            )
            for i in (0, 1)
            for j in (0, 1)
        ]

    def block_times_pair(
        self, a: list[Number], x: list[Number], beside: list[Number] | None = None, sign: str = "fsub"
    ) -> list[Number]:
        """Return A x, or y ± A x."""
        return [
            self.sum_of_products(
                (a[2 * i], x[0]), (a[2 * i + 1], x[1]), beside=None if beside is None else beside[i], sign=sign
            )
            for i in (0, 1)
        ]

    def inverse(self, a: list[Number]) -> list[Number]:
        """Return the inverse of a block."""
        code = self.code
        determinant = code.operation(
            f"fsub {FLAGS}",
            [code.operation(f"fmul {FLAGS}", [a[0], a[3]]), code.operation(f"fmul {FLAGS}", [a[1], a[2]])],
        )
        by = code.operation(f"fdiv {FLAGS}", [1.0, determinant])
        minus = code.operation("fneg", [by])
        return [
            code.operation(f"fmul {FLAGS}", [x, y]) for x, y in ((a[3], by), (a[1], minus), (a[2], minus), (a[0], by))
        ]

    def zeros(self, base: str, count: int) -> None:
        with self.code.loop(count) as at:
            self.store(0.0, base, at)

    def between(self, firsts: str, at: str) -> tuple[str, str]:
        """Return the position of the first list entry of one index, and the number of its entries."""
        begin = self.entry(firsts, at)
        return begin, self.code.whole("sub", self.entry(firsts, self.code.whole("add", at, 1)), begin)

    def loaded(self, base: str, shape: tuple[int, ...]) -> Array:
        return array_of([self.load(base, i) for i in range(math.prod(shape))], shape)


@dataclass(frozen=True)
class _Operand:
    """An array in memory, or several arrays, one for each direction."""

    place: str  # name of the address of the first number
    size: int  # count of numbers for one direction
    several: bool  # whether there are several directions

    def along(self, code: VectorCode, direction: str) -> str:
        """Return the name of the address of the first number of a direction."""
        if not self.several:
            return self.place
        return code.address(self.place, code.whole("mul", direction, self.size), lanes=True)


def written(
    primitive: Any,
    code: VectorCode,
    shared: SharedNumbers,
    parameters: dict[str, Any],
    taken: list[Value],
    numbers: Any,
    shape: tuple[int, ...],
) -> Array:
    """Write the vector code of a sparse primitive, and return its result."""
    writer, rows, directions = _Writer(code, shared), shape[-2], math.prod(shape[:-2])
    operands = []
    for value, axes in zip(taken, AXES[primitive], strict=True):
        of_value = value.values.shape if isinstance(value, Shared) else value.shape
        several = len(of_value) > axes
        operands.append(_Operand(writer.of(value, numbers), math.prod(of_value[several:]), several))
    result = _Operand(writer.memory(directions * rows), rows, len(shape) > 2)
    operation: Callable[..., None] = _sparse_times if primitive is sparse_times else _block_times
    if primitive is block_solve:
        # All directions share one matrix.
        *of_matrix, right = operands
        factors = _factors(writer, parameters["pattern"], *(operand.place for operand in of_matrix))
        operation, operands = functools.partial(_substituted, factors=factors), [right]
    with code.loop(directions) as direction:
        operation(writer, *parameters.values(), *(o.along(code, direction) for o in (*operands, result)))
    return writer.loaded(result.place, shape)


def _sparse_times(writer: _Writer, matrix: SparseMatrix, x: str, found: str) -> None:
    rows, columns = np.nonzero(matrix.dense)
    firsts = np.searchsorted(rows, np.arange(len(matrix.dense) + 1))
    values = writer.shared.place(matrix.dense[rows, columns])
    firsts_at, columns_at = writer.table(firsts), writer.table(columns)
    code, total = writer.code, writer.memory(1)
    with code.loop(len(matrix.dense)) as row:
        begin, count = writer.between(firsts_at, row)
        writer.store(0.0, total, 0)
        with code.loop(count) as at:
            index = code.whole("add", begin, at)
            value = code.load(code.address("%shared", code.whole("add", values, index)), lanes=False)
            product = (value, writer.load(x, writer.entry(columns_at, index)))
            writer.store(writer.sum_of_products(product, beside=writer.load(total, 0)), total, 0)
        writer.store(writer.load(total, 0), found, row)


def _block_times(writer: _Writer, pattern: BlockPattern, blocks: str, x: str, found: str) -> None:
    writer.zeros(found, 2 * pattern.size)
    rows, columns = writer.table(pattern.rows), writer.table(pattern.columns)
    with writer.code.loop(len(pattern.rows)) as at:
        row, column = writer.entry(rows, at), writer.entry(columns, at)
        block, pair = writer.block(blocks, at), writer.pair(x, column)
        writer.put(writer.block_times_pair(block, pair, writer.pair(found, row), "fadd"), found, row)


def _factors(writer: _Writer, pattern: BlockPattern, blocks: str, diagonal: str) -> str:
    """Compute the block LU of I + A D without pivoting: L is below the diagonal, U to its right; pivots are inverted."""
    plan, code = pattern.plan, writer.code
    matrix = writer.memory(4 * plan.count)
    writer.zeros(matrix, 4 * plan.count)
    given, columns = writer.table(plan.given), writer.table(pattern.columns)
    with code.loop(len(plan.given)) as at:
        product = writer.block_times_block(writer.block(blocks, at), writer.block(diagonal, writer.entry(columns, at)))
        writer.put(product, matrix, writer.entry(given, at))
    pivots, below, beside, target = (writer.table(t) for t in (plan.diagonal, plan.below, plan.beside, plan.target))
    first_below, first_target = writer.table(plan.first_below), writer.table(plan.first_target)
    with code.loop(pattern.size) as k:
        pivot = writer.entry(pivots, k)
        a = writer.block(matrix, pivot)
        one_more = [code.operation(f"fadd {FLAGS}", [a[i], 1.0]) if i in (0, 3) else a[i] for i in range(4)]
        inverse = writer.inverse(one_more)
        writer.put(inverse, matrix, pivot)
        begin, count = writer.between(first_below, k)
        with code.loop(count) as number:
            at = code.whole("add", begin, number)
            place_below = writer.entry(below, at)
            lower = writer.block_times_block(writer.block(matrix, place_below), inverse)
            writer.put(lower, matrix, place_below)
            targets = writer.entry(first_target, at)
            with code.loop(count) as across:
                upper = writer.block(matrix, writer.entry(beside, code.whole("add", begin, across)))
                position = writer.entry(target, code.whole("add", targets, across))
                writer.put(writer.block_times_block(lower, upper, writer.block(matrix, position)), matrix, position)
    return matrix


def _substituted(writer: _Writer, pattern: BlockPattern, right: str, x: str, factors: str) -> None:
    """Write the code of the forward and backward substitution."""
    plan, code = pattern.plan, writer.code
    with code.loop(2 * pattern.size) as at:
        writer.store(writer.load(right, at), x, at)
    order, pivots = writer.table(plan.order), writer.table(plan.diagonal)
    below, row_below, first_below = (writer.table(t) for t in (plan.below, plan.row_below, plan.first_below))
    beside, row_beside, first_beside = (writer.table(t) for t in (plan.beside, plan.row_beside, plan.first_beside))
    with code.loop(pattern.size) as k:
        pivot_pair = writer.pair(x, writer.entry(order, k))
        begin, count = writer.between(first_below, k)
        with code.loop(count) as number:
            at = code.whole("add", begin, number)
            row = writer.entry(row_below, at)
            lower = writer.block(factors, writer.entry(below, at))
            writer.put(writer.block_times_pair(lower, pivot_pair, writer.pair(x, row)), x, row)
    with code.loop(pattern.size) as done:
        k = code.whole("sub", pattern.size - 1, done)
        unknown = writer.entry(order, k)
        pivot_pair = writer.pair(x, unknown)
        sums = writer.memory(pivot_pair)
        begin, count = writer.between(first_beside, k)
        with code.loop(count) as number:
            at = code.whole("add", begin, number)
            upper = writer.block(factors, writer.entry(beside, at))
            other = writer.pair(x, writer.entry(row_beside, at))
            writer.put(writer.block_times_pair(upper, other, writer.pair(sums, "0")), sums, "0")
        inverse = writer.block(factors, writer.entry(pivots, k))
        writer.put(writer.block_times_pair(inverse, writer.pair(sums, "0")), x, unknown)
