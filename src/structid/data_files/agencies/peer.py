"""PEER AT2, VT2 and DT2: header lines with quantity, unit, count and time step, then the values."""

from __future__ import annotations

import re

import numpy as np

from structid.core.errors import InputError
from structid.core.units import same_dimension
from structid.data_files.base import FileChannel, FileFormat, check_count, check_step
from structid.data_files.file_content import FileContent, number
from structid.data_files.unit_spellings import QUANTITIES, UNITS, spelt_unit

_HEADER_LINES = 8
_NUMBER = r"(\d*[.,]?\d+(?:[eEdD][-+]?\d+)?|\d+[.,])"
_COUNT = re.compile(r"NPTS\s*[=:]\s*(\d+)", re.IGNORECASE)
_STEP = re.compile(rf"\bDT\s*[=:]\s*{_NUMBER}\s*(MSEC|MS\b|MILLISEC)?", re.IGNORECASE)
_OLD_HEADER = re.compile(rf"^\s*(\d+)\s+{_NUMBER}\s+.*NPTS\s*,?\s*DT\b", re.IGNORECASE)
_UNIT = re.compile(
    r"(?:\bIN\s+)?\bUNITS?\s*(?:OF|ARE(?:\s+IN)?|IN|[:=])\s*[(\[]?\s*(\d*\.?\d+\s+)?(%?[A-Za-z][\w*/^²]*)",
    re.IGNORECASE,
)
"""A stated unit, as in ACCELERATION TIME SERIES IN UNITS OF G."""

_BARE_UNIT = re.compile(
    r"(?<![A-Za-z/])((?:[cm]?m|in|ft)/s(?:ec)?(?:/s(?:ec)?|\*\*2|\^2|2|²)?|gals?|%g)(?![\w/])"
    r"|(?:\bin\s+|[(\[]\s*)([cm]m|g)\b",
    re.IGNORECASE,
)
"""A unit without the word, as in ACCELERATION (CM/SEC/SEC)."""

_PEER_WORDS = re.compile(r"PEER|STRONG.MOTION|ACCEL|PACIFIC", re.IGNORECASE)
_TITLE_LINES = 2
"""Lines above count and step in a file of PEER."""

_QUANTITY = re.compile(
    r"\b(ACC(?:ELERATION)?|VEL(?:OCITY)?|DISP(?:LACEMENT)?)\.?\s*(?:TIME\s+(?:SERIES|HISTORY)|DATA|\(|\[|,|(?:IN\s+)?UNITS|IN\b)",
    re.IGNORECASE,
)
_QUANTITIES = {"acc": "acceleration", "vel": "velocity", "dis": "displacement"}
_USUAL_UNITS = {"acceleration": "g", "velocity": "cm/s", "displacement": "cm"}
_SUFFIXES = {".at2": "acceleration", ".vt2": "velocity", ".dt2": "displacement"}


def recognises(content: FileContent) -> bool:
    """Whether count and step follow two title lines as in PEER's files, or the file's name ends as PEER's."""
    lines = content.lines[:_HEADER_LINES]
    named = any(content.path.lower().endswith(suffix) for suffix in _SUFFIXES)
    old = any(_OLD_HEADER.search(line) for line in lines[_TITLE_LINES:])
    count, step = ({n for n, line in enumerate(lines) if pattern.search(line)} for pattern in (_COUNT, _STEP))
    both = bool(count and step) and min(count | step) >= _TITLE_LINES
    commented = any(line.lstrip().startswith(("#", "%")) for line in lines)
    return named or ((old or both) and not commented)


def read(content: FileContent) -> list[FileChannel]:
    """Read the one channel."""
    count, step, last = _count_and_step(content)
    header = content.lines[: last + 1]
    unit = _unit(header)
    quantity = _quantity(content, header, unit)
    values = [
        number(word, content.at(index))
        for index in range(last + 1, len(content.lines))
        for word in _repaired(content.line(index)).split()
    ]
    check_count(content.at(last), f"NPTS = {count}", count, len(values))
    return [
        FileChannel(
            name=quantity,
            values=np.array(values),
            unit=unit,
            dt=check_step(content.at(last), step),
            quantity=quantity,
            where=content.at(last + 1),
            usual_unit=_USUAL_UNITS[quantity] if _is_of_peer(content, header) else "",
        )
    ]


def _is_of_peer(content: FileContent, header: list[str]) -> bool:
    """Whether name or header are PEER's, so that a missing unit is PEER's."""
    named = any(content.path.lower().endswith(suffix) for suffix in _SUFFIXES)
    return named or _PEER_WORDS.search("\n".join(header)) is not None


def _count_and_step(content: FileContent) -> tuple[int, float, int]:
    """Return NPTS, DT [s], and the index of the last header line."""
    count, step = None, None
    for index, line in enumerate(content.lines[:_HEADER_LINES]):
        old = _OLD_HEADER.search(line)
        if old is not None:
            return int(old.group(1)), _decimal(old.group(2)), index
        points, dt = _COUNT.search(line), _STEP.search(line)
        count = int(points.group(1)) if points else count
        step = _decimal(dt.group(1)) * (1e-3 if dt.group(2) else 1.0) if dt else step
        if count is not None and step is not None:
            return count, step, index
    raise InputError(
        f"{content.path}, lines 1-{_HEADER_LINES}",
        "no lines with NPTS and DT",
        "a PEER AT2 header such as 'NPTS= 4000, DT= .0100'",
        "For text columns, use another file extension, and a time column or dt: GroundMotion.read(path, dt=0.01, unit='g').",
    )


def _quantity(content: FileContent, header: list[str], unit: str) -> str:
    """Return the quantity that the header names; without one, that of the unit or of the file's name."""
    match = _QUANTITY.search("\n".join(header))
    if match is not None:
        return _QUANTITIES[match.group(1)[:3].lower()]
    of_unit = next((name for name, si in QUANTITIES.items() if unit[:1].isalpha() and same_dimension(unit, si)), None)
    if of_unit is not None:
        return of_unit
    suffix = content.path[-4:].lower()
    return _SUFFIXES.get(suffix, "acceleration")


def _unit(header: list[str]) -> str:
    """Return the unit in the header; empty if the header has none, with a question mark if nobody knows it."""
    for line in header:
        match = _UNIT.search(line)
        if match is None:
            continue
        spelt = match.group(2)
        unit = UNITS.get(spelt.lower()) or (spelt_unit(spelt) if _QUANTITY.search(line) or ":" in line else None)
        if unit is not None:
            return f"{match.group(1).strip()} {unit}" if match.group(1) else unit
        if _QUANTITY.search(line):
            return f"?{spelt}"  # an unknown unit: the user must give it
    bare = next((found for line in header if (found := _BARE_UNIT.search(line)) is not None), None)
    return UNITS.get((bare.group(1) or bare.group(2)).lower(), "") if bare is not None else ""


def _decimal(word: str) -> float:
    """Convert a number with a decimal comma or a Fortran exponent."""
    return float(re.sub("[dD]", "e", word.replace(",", ".")))


def _repaired(line: str) -> str:
    """Repair a line that Fortran printed with D exponents, decimal commas, or no space before negative values."""
    apart = re.sub(r"(?<=[\d.])-", " -", re.sub(r"(?<=[\d.])[dD](?=[-+]?\d)", "e", line))
    return re.sub(r"(?<=\d),(?=\d)|(?<=[\s-]),(?=\d)", ".", apart).replace(",", " ")


FORMAT = FileFormat("PEER AT2, VT2 or DT2", recognises, read)
