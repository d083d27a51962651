"""Numbers in vector code: constants in the text, and registers."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Register:
    """A number that is known when the code runs."""

    name: str  # Its name in the text
    kind: str  # What it is
    lanes: bool  # Whether each lane has its own


Number = float | bool | int | Register
"""A constant, or a register."""


def constant(number: Any, kind: str) -> str:
    """Write a constant, to its last bit."""
    if kind == "double":
        return f"0x{struct.unpack('>Q', struct.pack('>d', float(number)))[0]:016X}"
    return ("true" if number else "false") if kind == "i1" else str(int(number))
