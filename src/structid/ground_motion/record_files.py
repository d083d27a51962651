"""Readers of accelerogram formats with complete headers: PEER AT2 and ESM ASCII."""

from __future__ import annotations

import codecs
import os
import re
from pathlib import Path

import numpy as np

from structid.core.errors import InputError
from structid.core.units import STANDARD_GRAVITY, factor, factor_of

_NUMBER = r"(\d*[.,]?\d+(?:[eEdD][-+]?\d+)?|\d+[.,])"
_COUNT = re.compile(r"NPTS\s*[=:]\s*(\d+)", re.IGNORECASE)
_STEP = re.compile(rf"\bDT\s*[=:]\s*{_NUMBER}\s*(MSEC|MS\b|MILLISEC)?", re.IGNORECASE)
_OLD_HEADER = re.compile(rf"^\s*(\d+)\s+{_NUMBER}\s+.*NPTS\s*,\s*DT", re.IGNORECASE)
_ANOTHER_QUANTITY = re.compile(
    r"\b(VEL(?:OCITY)?|DISP(?:LACEMENT)?)\.?\s*(?:TIME\s+(?:SERIES|HISTORY)|DATA|\(|\[|,|(?:IN\s+)?UNITS)",
    re.IGNORECASE,
)
_UNIT = re.compile(r"\bUNITS?\s*(?:OF|ARE|IN|[:=])\s*[(\[]?\s*(%?[A-Za-z][\w*/^]*)", re.IGNORECASE)
_ANOTHER_UNIT = re.compile(r"(c|m)?m|in(ch(es)?)?|(c|m)?m/s(ec)?|in/s(ec)?", re.IGNORECASE)
"""Units of a velocity or a displacement."""

UNITS = {
    "g": "g",
    "gal": "cm/s^2",
    "gals": "cm/s^2",
    "mg": "0.001 g",
    "%g": "0.01 g",
    **{
        spelt: "cm/s^2"
        for spelt in ("cm/sec**2", "cm/s**2", "cm/s/s", "cm/sec/sec", "cm/sec2", "cm/s2", "cm/s^2", "cm/sec^2")
    },
    **{spelt: "m/s^2" for spelt in ("m/sec**2", "m/s**2", "m/s/s", "m/sec/sec", "m/sec2", "m/s2", "m/s^2", "m/sec^2")},
    **{spelt: "mm/s^2" for spelt in ("mm/sec**2", "mm/s**2", "mm/s/s", "mm/s2", "mm/s^2")},
}
"""Spellings of acceleration units in headers, in lower case."""


def read_peer(
    path: str | os.PathLike[str], unit: str | None = None, dt: float | None = None
) -> tuple[np.ndarray, float]:
    """Read a PEER ``.AT2`` file: up to eight header lines with count, time step, quantity and unit, then the values."""
    lines = lines_of(path)
    count, step, last = _count_and_step(path, lines)
    _check_step(f"{path}, line {last + 1}", step, dt)
    header = lines[: last + 1]
    another = _ANOTHER_QUANTITY.search("\n".join(header))
    if another is not None:
        raise InputError(
            f"{path}, lines 1-{last + 1}",
            f"'{another.group(0)}'",
            "an acceleration",
            "Use the .AT2 file of this record.",
        )
    by = _factor(path, header, unit)
    values = numbers_of(path, [_repaired(line) for line in lines[last + 1 :]], first_line=last + 2)
    _check_count(f"{path}, line {last + 1}", f"NPTS = {count}", values.size == count, values.size)
    return values * by, step


def _check_step(where: str, step: float, given: float | None) -> None:
    if given is not None and abs(given / step - 1.0) > 1e-6:
        cure = "Leave dt out, or correct the header."
        raise InputError(
            where, f"the header gives a time step of {step:g} s, but dt={given:g} is given", "one time step", cure
        )


def _check_count(where: str, declared: str, right: bool, found: int) -> None:
    if not right:
        raise InputError(
            where,
            f"the header gives {declared}, but {found} values follow",
            "the number of values in the header",
            "Download the file again, since it is incomplete or damaged.",
        )


def _count_and_step(path: str | os.PathLike[str], lines: list[str]) -> tuple[int, float, int]:
    """Return NPTS, DT [s], and the index of the last header line."""
    count, step = None, None
    for number, line in enumerate(lines[:8]):
        old = _OLD_HEADER.search(line)
        if old is not None:
            return int(old.group(1)), _decimal(old.group(2)), number
        points, dt = _COUNT.search(line), _STEP.search(line)
        count = int(points.group(1)) if points else count
        step = _decimal(dt.group(1)) * (1e-3 if dt.group(2) else 1.0) if dt else step
        if count is not None and step is not None:
            return count, step, number
    raise InputError(
        f"{path}, lines 1-8",
        "no lines with NPTS and DT",
        "a PEER AT2 header such as 'NPTS= 4000, DT= .0100'",
        "For text columns, use another file extension, and a time column or dt: GroundMotion.read(path, dt=0.01, unit='g').",
    )


def _factor(path: str | os.PathLike[str], header: list[str], unit: str | None) -> float:
    """Return the factor that converts the values to SI, from the header or the argument."""
    match = next(((n, m.group(1)) for n, line in enumerate(header, start=1) if (m := _UNIT.search(line))), None)
    given = None if unit is None else factor_of(unit, "m/s^2", f"{path}: unit")
    if match is None:
        return STANDARD_GRAVITY if given is None else given
    number, spelt = match
    factor_in_header = UNITS.get(spelt.lower())
    if _ANOTHER_UNIT.fullmatch(spelt):
        raise InputError(
            f"{path}, line {number}",
            f"'{spelt}' is not a unit of acceleration",
            "g, gal, cm/sec**2, m/sec**2, …",
            "Use the acceleration file of this record. If the values are accelerations, correct the header.",
        )
    if factor_in_header is None:
        if given is not None:
            return given
        raise InputError(
            f"{path}, line {number}",
            f"the unit '{spelt}'",
            "g, gal, cm/sec**2, m/sec**2, …",
            "Give the unit: GroundMotion.read(path, unit='cm/s^2').",
        )
    by = factor(factor_in_header)
    if given is not None and abs(given / by - 1.0) > 1e-3:
        raise InputError(
            f"{path}, line {number}",
            f"the header gives '{spelt}', but unit='{unit}' is given",
            "one unit",
            "Leave the unit out, or correct the header.",
        )
    return by


def _decimal(word: str) -> float:
    """Convert a number with a decimal comma or a Fortran exponent."""
    return float(re.sub("[dD]", "e", word.replace(",", ".")))


def _repaired(line: str) -> str:
    """Repair a line that Fortran printed with D exponents, decimal commas, or no space before negative values."""
    apart = re.sub(r"(?<=[\d.])-", " -", re.sub(r"(?<=[\d.])[dD](?=[-+]?\d)", "e", line))
    return re.sub(r"(?<=\d),(?=\d)|(?<=[\s-]),(?=\d)", ".", apart).replace(",", " ")


def read_esm(
    path: str | os.PathLike[str], unit: str | None = None, dt: float | None = None
) -> tuple[np.ndarray, float]:
    """Read an ESM ASCII file: lines ``KEY: value``, then one value per line."""
    lines = lines_of(path)
    keys = {key.strip(): value.strip() for key, colon, value in (line.partition(":") for line in lines) if colon}
    last = max(number for number, line in enumerate(lines) if ":" in line)
    if keys.get("DATA_TYPE", "ACCELERATION").upper() != "ACCELERATION":
        raise InputError(
            f"{path}", f"DATA_TYPE: {keys['DATA_TYPE']}", "ACCELERATION", "Use the acceleration file of this record."
        )
    step = re.fullmatch(_NUMBER, keys.get("SAMPLING_INTERVAL_S", ""))
    if step is None or (unit is None and not keys.get("UNITS")):
        raise InputError(
            f"{path}, lines 1-{last + 1}",
            f"UNITS: {keys.get('UNITS', '')}, SAMPLING_INTERVAL_S: {keys.get('SAMPLING_INTERVAL_S', '')}",
            "a unit and a time step in seconds",
            "Complete the header, or give the unit: GroundMotion.read(path, unit='cm/s^2').",
        )
    _check_step(f"{path}", _decimal(step.group(1)), dt)
    by = _factor(path, lines[: last + 1], unit)
    values = numbers_of(path, lines[last + 1 :], first_line=last + 2)
    declared = keys.get("NDATA", str(values.size))
    _check_count(f"{path}", f"NDATA: {declared}", declared == str(values.size), values.size)
    return values * by, _decimal(step.group(1))


# --- text -----------------------------------------------------------------------------------------------------------


def lines_of(path: str | os.PathLike[str]) -> list[str]:
    """Read the lines of a text file with any line ending."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{path}", "there is no such file", "a readable file", "Check the name and the folder.")
    raw = file.read_bytes()
    marked = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    text = raw.decode("utf-16" if marked else "utf-8-sig", errors="replace")
    # Lines of files copied between systems may end in \r\r\n; only \n counts as the end of a line.
    lines = [line.strip("\r") for line in (text.split("\n") if "\n" in text else text.split("\r"))]
    if not any(line.strip() for line in lines):
        raise InputError(f"{path}", "the file is empty", "a record", "Download it again.")
    return lines


def numbers_of(path: str | os.PathLike[str], lines: list[str], first_line: int) -> np.ndarray:
    """Read all numbers of the given lines."""
    values: list[float] = []
    for number, line in enumerate(lines, start=first_line):
        for word in line.split():
            try:
                value = float(word)
            except ValueError:
                raise InputError(f"{path}, line {number}", f"'{word}' is not a number", "numbers") from None
            if not np.isfinite(value):
                raise InputError(
                    f"{path}, line {number}",
                    f"'{word}'",
                    "finite numbers",
                    "Repair the record: structid does not fill gaps.",
                )
            values.append(value)
    return np.array(values)
