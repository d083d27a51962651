"""LLVM code of a function of many runs: an outer loop over blocks of runs, and inside it the function of one run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from structid.engine.vector_code.operations import Function
from structid.engine.vector_code.registers import Number, Register
from structid.engine.vector_code.translation import LARGEST_ROW, Translator
from structid.engine.vector_code.values import SIGNALS, History, InThreadMemory, Value
from structid.engine.vector_code.vector_code import VectorCode

ENTRY = "run_blocks"
"""Name of the compiled function."""

SIGNATURE = (
    "ptr noalias %arguments, ptr noalias %shared, ptr noalias %signals, ptr noalias %results, ptr noalias %histories, "
    "ptr %next_block, i64 %stride, i64 %blocks"
)
"""Arguments of the compiled function.

In arguments, results and histories the run axis comes last, with length `stride`. In signals the block axis comes first
and the lane axis last. Each thread takes its next block from a counter that all threads share."""

LINE_OF_CACHE = 64
"""Size of a cache line [byte]. The stack is aligned to it, so that a register spilled to the stack lies within one
line. With the default alignment, many of these registers would lie across two lines."""

LARGEST_STACK = 1 << 17
"""Largest number of doubles for histories on a thread's stack: one megabyte."""


@dataclass(frozen=True)
class Kernel:
    """LLVM code of a function of many runs, with its memory layout."""

    text: str  # LLVM code
    width: int  # runs in a block
    shared: np.ndarray  # numbers that all runs share
    # Location of each output: a history, or consecutive rows of the results
    outputs: tuple[History | tuple[int, ...], ...]
    taken: int  # rows of the arguments
    rows: int  # rows of the results
    histories: int  # rows of the buffer of histories
    arrays: dict[bytes, int]  # position of each long array among the shared numbers

    def with_array(self, old: np.ndarray, new: np.ndarray) -> Kernel:
        """Return a copy with the only long array replaced by another array of the same shape."""
        [(held, first)] = self.arrays.items()
        assert held == old.tobytes(), "the table must contain the old array unchanged"
        shared = self.shared.copy()
        shared[first : first + new.size] = new.reshape(-1)
        return replace(self, shared=shared)


def kernel(function: Function, width: int, foreign: Sequence[Any] = ()) -> Kernel:
    """Translate a function of one run to LLVM code for many runs."""
    code = VectorCode(width)
    translator = Translator(code)
    theta, *signals = (v.aval for v in function.invars)
    outputs: list[History | tuple[int, ...]] = []
    read, written = 0, 0
    with code.shared_loop("%next_block", "%blocks") as block:
        column = code.whole("mul", block, width)
        beginning = len(code.lines)

        def row(base: str, number: int) -> str:
            return code.address(base, code.whole("add", code.whole("mul", "%stride", number), column))

        arguments: list[Value] = []
        for aval in (theta, *(v.aval for v in foreign)):
            if math.prod(aval.shape) > LARGEST_ROW:
                arguments.append(_in_memory(code, aval.shape, read, column, translator.shared.length))
                read += math.prod(aval.shape)
                continue
            numbers = np.empty(aval.shape, dtype=object)
            for index in np.ndindex(aval.shape):
                number: Number = code.load(row("%arguments", read), lanes=True)
                if aval.dtype == np.bool_:
                    number = code.operation("fcmp une", [number, 0.0], result="i1")
                numbers[index], read = number, read + 1
            arguments.append(numbers)
        inputs: list[Value] = [arguments[0], *(History(SIGNALS, aval.shape) for aval in signals)]
        for value in translator.function(function, inputs, dict(zip(foreign, arguments[1:], strict=True))):
            if isinstance(value, History) and value.number != SIGNALS:
                outputs.append(value)
                continue
            numbers = translator.numbers(value)
            for number in numbers.reshape(-1):
                if isinstance(number, Register) and number.kind == "i1":
                    number = code.cast("uitofp", number, "double")
                code.store(number, row("%results", written), lanes=True)
                written += 1
            outputs.append(numbers.shape)
        memory = _Memory(translator, {output.number for output in outputs if isinstance(output, History)})
        signals_of_a_run = sum(math.prod(aval.shape) for aval in signals)
        code.lines[beginning:beginning] = memory.of_block(block, column, signals_of_a_run)
    places = memory.entry  # must be evaluated first, because it adds loads to `code.entry`
    body = "\n".join([*code.entry, *places, *code.lines])
    text = f"define void @{ENTRY}({SIGNATURE}) nounwind alignstack({LINE_OF_CACHE}) {{\n{body}\n  ret void\n}}\n"
    result = tuple(memory.in_buffer(output) if isinstance(output, History) else output for output in outputs)
    shared = translator.shared
    return Kernel(text, width, shared.values, result, read, written, memory.rows, shared.arrays)


def _in_memory(
    code: VectorCode, shape: tuple[int, ...], first: int, column: str, length: Callable[[int], str]
) -> InThreadMemory:
    """Copy rows of the arguments to contiguous memory of this thread."""
    size = math.prod(shape)
    slot = code.slot(lanes=True, count=size)
    with code.loop(length(size)) as at:
        row = code.whole("mul", "%stride", code.whole("add", at, first))
        number = code.load(code.address("%arguments", code.whole("add", row, column)), lanes=True)
        code.store(number, code.address(slot, at, lanes=True), lanes=True)
    return InThreadMemory(slot, shape)


class _Memory:
    """Memory for histories: a buffer for returned or large histories, and the stack of each thread for the others."""

    def __init__(self, translator: Translator, returned: set[int]) -> None:
        self._translator, self.rows = translator, 0
        self._first: dict[int, int] = {}
        on_stack = 0
        for number, rows in enumerate(translator.kept):
            on_stack += 0 if number in returned else rows
            if number in returned or on_stack * translator.code.width > LARGEST_STACK:
                self._first[number] = self.rows
                self.rows += rows

    @property
    def entry(self) -> list[str]:
        """LLVM code at the start of the function: base address and row spacing of every history."""
        code, lines = self._translator.code, [f"  %each_signal = add i64 {self._translator.code.width}, 0"]
        for number, rows in enumerate(self._translator.kept):
            if number in self._first:
                lines.append(f"  %kept{number} = getelementptr double, ptr %histories, i64 0")
                lines.append(f"  %each{number} = add i64 %stride, 0")
            else:
                size = self._translator.shared.length(rows)
                lines.append(f"  %kept{number} = alloca {code.type_of('double', True)}, i64 {size}, align 64")
                lines.append(f"  %each{number} = add i64 {code.width}, 0")
        return lines

    def of_block(self, block: str, column: str, signals: int) -> list[str]:
        """Return LLVM code for the start of a block: the position of its first run in every history."""
        code, shared = self._translator.code, self._translator.shared
        of_block = code.name("n")
        lines = [f"  {of_block} = mul i64 {block}, {shared.length(signals)}"]
        lines.append(f"  %across_signals = mul i64 {of_block}, {code.width}")
        for number in range(len(self._translator.kept)):
            first = self._first.get(number)
            if first:
                before = code.name("n")
                lines.append(f"  {before} = mul i64 %stride, {shared.length(first)}")
                lines.append(f"  %across{number} = add i64 {before}, {column}")
            else:
                lines.append(f"  %across{number} = add i64 {'0' if first is None else column}, 0")
        return lines

    def in_buffer(self, history: History) -> History:
        """Assign rows of the buffer to a returned history."""
        return replace(history, first=history.first + self._first[history.number])
