"""The content of a file: bytes, lines of text, and the numbers in lines."""

from __future__ import annotations

import codecs
import math
import os
import re
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError

_FORTRAN = re.compile(r"\(\s*(?:\d+\s*P\s*,?\s*)?(\d*)\s*([IFEGD])\s*(\d+)(?:\.(\d+))?\s*[A-Z]?\d*\s*\)", re.IGNORECASE)
"""A Fortran format such as (8F10.5), (10I8) or (1P5E15.7): values per line, type, width, decimals."""

_BINARY_BYTES = bytes(sorted(set(range(32)) - {7, 8, 9, 10, 11, 12, 13, 26, 27}))
"""Control characters that text does not contain."""


class FileContent:
    """A file on disk, read once. Its lines are decoded only when a text format asks for them."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = str(path)
        file = Path(path)
        if file.is_dir():
            raise InputError(self.path, "this is a folder", "a file", "Give the name of one file in it.")
        if not file.is_file():
            raise InputError(self.path, "there is no such file", "a readable file", "Check the name and the folder.")
        self.raw = file.read_bytes()

    @cached_property
    def is_binary(self) -> bool:
        """Whether the file has bytes that no text has."""
        if self.raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return False
        return len(self._text.translate(None, _BINARY_BYTES)) < len(self._text)

    @property
    def _text(self) -> bytes:
        """The bytes without zeros or an end-of-file mark (Ctrl-Z) behind the last line."""
        return self.raw.rstrip(b"\0\x1a\r\n")

    @cached_property
    def lines(self) -> list[str]:
        """The lines of a text file with any line ending."""
        marked = self.raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        try:
            text = self.raw.decode("utf-16") if marked else self._text.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = self.raw.decode("utf-16", errors="replace") if marked else self._text.decode("latin-1")
        if "\u2212" in text or "\u202f" in text or "\u00a0" in text:
            # typographic minus signs, and spaces between thousands
            text = re.sub("(?<=\\d)[\u202f\u00a0](?=\\d{3})", "", text.replace("\u2212", "-"))
        # Lines of files copied between systems may end in \r\r\n; only \n counts as the end of a line.
        lines = [line.strip("\r") for line in (text.split("\n") if "\n" in text else text.split("\r"))]
        if not any(line.strip() for line in lines):
            raise InputError(self.path, "the file is empty", "a record", "Download it again.")
        return lines

    @cached_property
    def head(self) -> str:
        """The first forty lines."""
        return "\n".join(self.lines[:40])

    def line(self, index: int) -> str:
        """Return a line by its index from 0; lines beyond the end are empty."""
        return self.lines[index] if 0 <= index < len(self.lines) else ""

    def at(self, index: int) -> str:
        """Name the file and a line, for messages."""
        return f"{self.path}, line {index + 1}"

    def find(self, pattern: str, start: int = 0, stop: int | None = None) -> tuple[int, re.Match[str]] | None:
        """Return the index and the match of the first line that contains a pattern, in any case."""
        compiled = re.compile(pattern, re.IGNORECASE)
        for index in range(start, len(self.lines) if stop is None else min(stop, len(self.lines))):
            if (match := compiled.search(self.lines[index])) is not None:
                return index, match
        return None

    def require(self, what: str, pattern: str, start: int = 0, stop: int | None = None) -> tuple[int, re.Match[str]]:
        """Return the index and the match of a line that the format requires."""
        place = self.find(pattern, start, stop)
        if place is None:
            last = len(self.lines) if stop is None else min(stop, len(self.lines))
            raise InputError(
                f"{self.path}, lines {start + 1}-{last}",
                f"no line with the {what}",
                "a complete header",
                "Download the file again, since its header is incomplete or damaged.",
            )
        return place

    def refuse_rest(self, index: int) -> None:
        """Refuse a line with content at or after an index, where the file should end."""
        for later in range(index, len(self.lines)):
            if self.lines[later].strip():
                raise InputError(
                    self.at(later),
                    f"'{self.lines[later].strip()[:40]}' after the last value",
                    "the end of the file",
                    "Download the file again, since the header's number of values or the file is damaged.",
                )


def fortran_format(text: str) -> tuple[int, int] | None:
    """Return values per line and width of a value from a Fortran format in a text, if there is one."""
    match = _FORTRAN.search(text)
    return None if match is None else (int(match.group(1) or 1), int(match.group(3)))


def fixed_width(
    content: FileContent, start: int, count: int, per_line: int, width: int, indent: int = 0
) -> tuple[Float[np.ndarray, " value"], int]:
    """Read `count` values of fixed width from the line `start`; return them and the index of the next line."""
    lines = -(-count // per_line)
    values: list[float] = []
    for index in range(start, start + lines):
        expected = min(per_line, count - len(values))
        values.extend(_cells(content, index, expected, width, indent))
    return np.array(values), start + lines


def _cells(content: FileContent, index: int, expected: int, width: int, indent: int) -> list[float]:
    """Read the values of one line of fixed width, behind `indent` blank characters."""
    line = content.line(index).rstrip()
    line = line[indent:] if not line[:indent].strip() else line
    if len(line) != expected * width:
        raise InputError(
            content.at(index),
            f"{len(line)} characters",
            f"{expected * width}, for {expected} values of {width} characters, as the header declares",
            "Download the file again, since lines are missing, shortened or doubled.",
        )
    cells = [line[at : at + width] for at in range(0, len(line), width)]
    return [number(cell, content.at(index)) for cell in cells]


def number(word: str, where: str) -> float:
    """Convert a number, which may have a Fortran exponent, and must be finite."""
    try:
        value = float(word)
    except ValueError:
        value = _fortran_number(word, where)
    if not math.isfinite(value):
        raise InputError(
            where, f"'{word.strip()}'", "finite numbers", "Repair the record: structid does not fill gaps."
        )
    return value


def _fortran_number(word: str, where: str) -> float:
    """Convert a number with an exponent D, as in 1.5D-03."""
    try:
        return float(re.sub(r"(?<=[\d.])[dD](?=[-+]?\d)", "e", word))
    except ValueError:
        raise InputError(where, f"'{word.strip()}' is not a number", "numbers", "Download the file again.") from None


def numbers(content: FileContent, start: int, stop: int | None = None) -> Float[np.ndarray, " value"]:
    """Read all numbers of some lines; spaces separate them."""
    values: list[float] = []
    for index in range(start, len(content.lines) if stop is None else stop):
        values.extend(number(word, content.at(index)) for word in content.line(index).split())
    return np.array(values)


def spaced_numbers(content: FileContent, start: int, per_line: int, width: int) -> Float[np.ndarray, " value"]:
    """Read numbers of a fixed width, of which the last character is a space; only the last line may have fewer."""
    last = len(content.lines)
    while last > start and not content.line(last - 1).strip():
        last -= 1
    for index in range(start, last):
        line = content.line(index).rstrip()
        count = len(line.split())
        if len(line) != count * width - 1 or not (count == per_line or (index == last - 1 and count < per_line)):
            raise InputError(
                content.at(index),
                f"{count} numbers in {len(line)} characters",
                f"{per_line} in {per_line * width - 1}",
                "Download the file again, since lines are damaged.",
            )
    return numbers(content, start, last)


def table(content: FileContent, start: int, columns: int, stop: int | None = None) -> Float[np.ndarray, "time column"]:
    """Read lines with a given number of values each; blank lines at the end do not count."""
    last = len(content.lines) if stop is None else stop
    while last > start and not content.line(last - 1).strip():
        last -= 1
    rows = np.empty((last - start, columns))
    for row, index in enumerate(range(start, last)):
        words = content.line(index).split()
        if len(words) != columns:
            raise InputError(
                content.at(index),
                f"{len(words)} values",
                f"{columns}, as in the other lines",
                "Download the file again, since lines are damaged.",
            )
        rows[row] = [number(word, content.at(index)) for word in words]
    return rows


def keys(lines: Sequence[str]) -> dict[str, str]:
    """Return the lines ``KEY: value`` as a dictionary."""
    pairs = (line.partition(":") for line in lines)
    return {key.strip(" #"): value.strip() for key, colon, value in pairs if colon}
