"""Numbers in vector code: constants in the text, and registers."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Register:
    """A number that is known when the code runs.

    Parameters
    ----------
    name : str
        Its name in the text.
    kind : {"double", "i1", "i64"}
        What it is.
    lanes : bool
        Whether each lane has its own.
    """

    name: str
    kind: str
    lanes: bool


Number = float | bool | int | Register
"""A constant, or a register."""


def constant(number: Any, kind: str) -> str:
    """Write a constant, to its last bit.

    Parameters
    ----------
    number : float, bool or int
        The constant.
    kind : {"double", "i1", "i64"}
        What it is.

    Returns
    -------
    str
        In LLVM's words.
    """
    if kind == "double":
        return f"0x{struct.unpack('>Q', struct.pack('>d', float(number)))[0]:016X}"
    return ("true" if number else "false") if kind == "i1" else str(int(number))
