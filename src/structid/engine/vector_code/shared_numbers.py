"""Table of the numbers that all runs share; the kernel receives it, so that new values need no new compilation."""

from __future__ import annotations

import numpy as np

from structid.engine.vector_code.registers import Register
from structid.engine.vector_code.vector_code import VectorCode


class SharedNumbers:
    """The table of shared numbers, and the LLVM code that reads it.

    The first part of the table has fixed positions in the LLVM code. It includes the positions and lengths of the long
    arrays, which form the second part.
    """

    def __init__(self, code: VectorCode) -> None:
        self._code = code
        self._numbers: list[float] = []
        self._places: dict[bytes, int] = {}
        self._loaded: dict[int, Register] = {}
        self._whole: dict[bytes | tuple[int, int], tuple[int, str]] = {}
        self._rows: dict[bytes, np.ndarray] = {}

    @property
    def values(self) -> np.ndarray:
        """The whole table; integers are stored as their bits."""
        table = np.concatenate([np.array(self._numbers or [0.0]), *self._rows.values()])
        whole, arrays = table.view(np.int64), self.arrays
        for key, (position, _) in self._whole.items():
            whole[position] = arrays[key] if isinstance(key, bytes) else key[0]
        return table

    @property
    def arrays(self) -> dict[bytes, int]:
        """Position of each long array in the table."""
        lengths = [max(len(self._numbers), 1), *map(len, self._rows.values())]
        return dict(zip(self._rows, np.cumsum(lengths).tolist(), strict=False))

    def loaded(self, values: np.ndarray) -> list[Register]:
        """Load each number of an array into a register, once, at the start of the function."""
        flat = np.ascontiguousarray(values, dtype=np.float64).reshape(-1)
        first = self._places.setdefault(flat.tobytes(), len(self._numbers))
        if first == len(self._numbers):
            self._numbers += flat.tolist()
        for position in range(first, first + len(flat)):
            if position not in self._loaded:
                self._loaded[position] = self._code.load_once("%shared", position)
        return [self._loaded[position] for position in range(first, first + len(flat))]

    def length(self, length: int) -> str:
        """Register a length in the table."""
        # Equal lengths also have separate positions, so that the text is the same for any lengths.
        return self._whole_number((length, len(self._whole)))

    def place(self, values: np.ndarray) -> str:
        """Append a long array."""
        flat = np.ascontiguousarray(values, dtype=np.float64).reshape(-1)
        self._rows[flat.tobytes()] = flat
        return self._whole_number(flat.tobytes())

    def at(self, place: str, count: int) -> list[Register]:
        """Load `count` consecutive numbers, starting at position `place` of the table."""
        code = self._code
        places = [code.address("%shared", code.whole("add", place, index)) for index in range(count)]
        return [code.load(at, lanes=False) for at in places]

    def _whole_number(self, key: bytes | tuple[int, int]) -> str:
        """Return the register name of a length or position, whose value is known only when the table is complete."""
        if key not in self._whole:
            position = len(self._numbers)
            self._whole[key] = position, self._code.load_once("%shared", position, "i64").name
            self._numbers.append(0.0)
        return self._whole[key][1]
