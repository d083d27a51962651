"""The text of a compiled function of many runs: blocks of lanes outside, the function of one run inside."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from structid.mechanics.lanes.operations import Function
from structid.mechanics.lanes.translation import History, Translator, Value
from structid.mechanics.lanes.vector_code import Number, Register, VectorCode

ENTRY = "run_blocks"
"""Name of the compiled function."""

SIGNATURE = (
    "ptr noalias %arguments, ptr noalias %shared, ptr noalias %signals, ptr noalias %results, ptr noalias %histories, "
    "ptr %next_block, i64 %stride, i64 %blocks"
)
"""Its arguments. Arguments, results and histories have the runs last, `stride` of them; signals have the blocks first, and in each
the lanes last. Threads take blocks from one counter."""


@dataclass(frozen=True)
class Kernel:
    """A function of many runs as text, and what goes with it.

    Parameters
    ----------
    text : str
        For LLVM.
    width : int
        Runs in a block.
    shared : ndarray
        Numbers that all runs share.
    outputs : tuple of History or shape
        Where each output is: a history, or rows of the results one after the other.
    taken, rows, histories : int
        Rows of the arguments, of the results, and of the buffer of histories.
    """

    text: str
    width: int
    shared: np.ndarray
    outputs: tuple[History | tuple[int, ...], ...]
    taken: int
    rows: int
    histories: int


def kernel(function: Function, width: int, foreign: Sequence[Any] = ()) -> Kernel:
    """Write a function of one run as one of many.

    Parameters
    ----------
    function : Function
        Of the numbers of one run and, where runs have them, of its signals (time, signal, 1).
    width : int
        Runs in a block.
    foreign : sequence of Var
        Results in it that somebody else computes: further arguments.

    Returns
    -------
    Kernel
        The text, and what goes with it.

    Raises
    ------
    UntranslatableError
        If something in it has no vector code.
    """
    code = VectorCode(width)
    theta, *signals = (v.aval for v in function.invars)
    translator = Translator(code, sum(math.prod(aval.shape) for aval in signals))
    outputs: list[History | tuple[int, ...]] = []
    taken, written = 0, 0

    def row(base: str, number: int) -> str:
        return code.address(base, code.whole("add", code.whole("mul", "%stride", number), translator.column))

    with code.shared_loop("%next_block", "%blocks") as block:
        translator.block, translator.column = block, code.whole("mul", block, width)
        arguments = []
        for aval in (theta, *(v.aval for v in foreign)):
            numbers = np.empty(aval.shape, dtype=object)
            for place in np.ndindex(aval.shape):
                number: Number = code.load(row("%arguments", taken), lanes=True)
                if aval.dtype == np.bool_:
                    number = code.operation("fcmp une", [number, 0.0], result="i1")
                numbers[place], taken = number, taken + 1
            arguments.append(numbers)
        own: list[Value] = [arguments[0], *(History(0, aval.shape, given=True) for aval in signals)]
        for value in translator.function(function, own, dict(zip(foreign, arguments[1:], strict=True))):
            if isinstance(value, History) and not value.given:
                outputs.append(value)
                continue
            numbers = translator.numbers(value)
            for number in numbers.reshape(-1):
                if isinstance(number, Register) and number.kind == "i1":
                    number = code.cast("uitofp", number, "double")
                code.store(number, row("%results", written), lanes=True)
                written += 1
            outputs.append(numbers.shape)
    body = "\n".join([*code.entry, *code.lines])
    text = f"define void @{ENTRY}({SIGNATURE}) nounwind {{\n{body}\n  ret void\n}}\n"
    return Kernel(text, width, translator.shared.values, tuple(outputs), taken, written, translator.rows)
