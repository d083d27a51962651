"""Numbers that a loop keeps in memory: numbers that change in each iteration, and small tables."""

from __future__ import annotations

import numpy as np

from structid.engine.vector_code.primitives import Array
from structid.engine.vector_code.registers import Number, Register
from structid.engine.vector_code.values import array_of
from structid.engine.vector_code.vector_code import VectorCode


class Slots:
    """An array in memory that changes in each iteration of a loop, with separate values for each lane."""

    def __init__(self, code: VectorCode, start: Array) -> None:
        self._code, self._shape = code, start.shape
        self._kinds = [kind_of(number) for number in start.reshape(-1)]
        self._places = [code.slot(lanes=True, kind=kind) for kind in self._kinds]
        self.write(start)

    def read(self) -> Array:
        """Load the numbers."""
        numbers = [self._code.load(p, lanes=True, kind=k) for p, k in zip(self._places, self._kinds, strict=True)]
        return array_of(numbers, self._shape)

    def write(self, numbers: Array) -> None:
        """Store the numbers."""
        for number, address, kind in zip(numbers.reshape(-1), self._places, self._kinds, strict=True):
            self._code.store(number, address, lanes=True, kind=kind)


def kind_of(number: Number) -> str:
    """Return the LLVM type of a number."""
    if isinstance(number, Register):
        return number.kind
    return "i1" if isinstance(number, (bool, np.bool_)) else "double"


class LookupTable:
    """A small table in memory; a loop reads its rows in turn."""

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
        return array_of([code.load(address, self._lanes) for address in places], self._shape)
