"""Numbers in vector code: constants and registers."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Register:
    """A number that is known only at run time."""

    name: str  # name in the LLVM code
    kind: str  # LLVM type
    lanes: bool  # whether each lane has its own value


Number = float | bool | int | Register
"""A constant or a register."""


def constant(number: Any, kind: str) -> str:
    """Return a constant as an LLVM literal that is exact to the last bit."""
    if kind == "double":
        return f"0x{struct.unpack('>Q', struct.pack('>d', float(number)))[0]:016X}"
    return ("true" if number else "false") if kind == "i1" else str(int(number))
