"""Readers of signals: accelerograms by format, and text files with columns."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.units import factor, factor_of, same_dimension
from structid.ground_motion.record_files import UNITS, lines_of, numbers_of, read_esm, read_peer

NOT_READ = {
    "COSMOS": re.compile(r"COSMOS\s+FORMAT|\(\s*FORMAT\s+V\s*\d", re.IGNORECASE),
    "CSMIP volume 1 or 2": re.compile(r"(UN)?CORRECTED ACCELEROGRAM", re.IGNORECASE),
}
"""Unsupported formats, recognised by their first lines."""


ROUNDED_TIME = 0.05
"""Largest error of a printed time, as a fraction of the time step."""
LARGEST_DENOMINATOR = 100_000
"""Largest denominator of a time step, as a fraction of a second; no instrument needs a larger denominator."""

_DATE, _CLOCK = r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}", r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d+)?)?Z?"
_STAMP = re.compile(rf'"?({_DATE}(?:[T ]+{_CLOCK})?|{_CLOCK})"?(?=[\s;,]|$)')
"""A date, a time of day, or both, at the start of a line."""

_EMPTY_CELL = re.compile(r"(?:^|[,;])\s*[,;]")
"""Empty cell between two separators, or before the first."""

_MAYBE_DECIMAL_COMMA = re.compile(r"[-+]?(\d+|\d*[.,]\d+|\d+[.,])([eEdD][-+]?\d+)?")
"""A number that may have a decimal comma."""


def read_acceleration(
    path: str | os.PathLike[str], dt: float | None = None, unit: str | None = None, column: int | None = None
) -> tuple[np.ndarray, float]:
    """Read a ground acceleration from a PEER ``.AT2`` file, an ESM ASCII file, or a text file with columns."""
    if Path(path).suffix.lower() == ".at2":
        return read_peer(path, unit, dt)
    first = "\n".join(lines_of(path)[:40])
    if "SAMPLING_INTERVAL_S:" in first:
        return read_esm(path, unit, dt)
    for name, sign in NOT_READ.items():
        if sign.search(first):
            raise InputError(
                f"{path}",
                f"the format {name} is not supported",
                "PEER AT2, ESM ASCII, or text with a time and an acceleration column",
                "Convert the file, or extract its accelerations, one per line: GroundMotion.read(path, dt=0.01, unit='cm/s^2').",
            )
    if unit is None:
        raise InputError(
            f"{path}",
            "the unit of a text file is missing",
            "unit='g', 'm/s^2', 'cm/s^2', …",
            "Give the unit of the values: GroundMotion.read(path, unit='g').",
        )
    _, step, values = read_columns(path, unit, dt, column, "m/s^2")
    return values[:, 0], step


class Columns(NamedTuple):
    """Columns of a text file, with a constant time step."""

    start: float  # Time of the first line [s]; 0 for a file without times
    dt: float  # Time step [s]
    values: Float[np.ndarray, "time column"]  # requested columns in SI


def read_columns(
    path: str | os.PathLike[str],
    unit: str,
    dt: float | None = None,
    column: int | None = None,
    si_unit: str | None = None,
    others: Sequence[int] = (),
) -> Columns:
    """Read a signal from text columns: times and values, or only values with a given time step."""
    table, numbers, titles, stamp = _table(path)
    if stamp and dt is None:
        raise InputError(
            f"{path}, line {numbers[0]}",
            f"a date or a time of day, '{stamp}', in the first column",
            "times in seconds, or a time step",
            "Give the step and the column of the values: dt=0.01, column=1.",
        )
    columns = [_column(path, table, numbers, dt, len(others)) if column is None else column, *others]
    for index in columns:
        if not 0 <= index < table.shape[1]:
            raise InputError(
                f"{path}",
                f"column {index} is missing, since the file has {table.shape[1]} columns",
                f"a column from 0 to {table.shape[1] - 1}",
                "Give an existing column. For a file with a single column, give dt.",
            )
    start = 0.0 if dt is not None else float(table[0, 0])
    step = _constant_step(path, table[:, 0], numbers) if dt is None else dt
    by = factor(unit) if si_unit is None else factor_of(unit, si_unit, f"{path}: unit")
    if len(titles) == table.shape[1]:
        for index in columns:
            _check_unit_of_title(f"{path}, line {numbers[0] - 1}", titles[index], unit)
    return Columns(start, step, table[:, columns] * by)


def _column(path: str | os.PathLike[str], table: np.ndarray, numbers: list[int], dt: float | None, others: int) -> int:
    """Return the column of the values, if it is unambiguous."""
    columns, where = table.shape[1], f"{path}, line {numbers[0]}"
    wrapped = "If the record continues from line to line, write one value per line and give dt."
    if dt is not None and columns > 1 + others:
        allowed = f"column=0 to {columns - 1}, or one value per line"
        cure = f"{wrapped} If there is a time column, leave dt out."
        raise InputError(where, f"{columns} values per line and a time step, but no column is named", allowed, cure)
    if columns > 2 + others:
        allowed = f"column=1 to {columns - 1}, since column 0 is the time"
        raise InputError(where, f"{columns} values per line, but no column is named", allowed, wrapped)
    return 0 if dt is not None else 1


def _check_unit_of_title(where: str, title: str, unit: str) -> None:
    """Refuse a unit that contradicts the unit in brackets in the column title."""
    bracketed = re.search(r"[(\[]\s*([^)\]]+?)\s*[)\]]", title)
    if bracketed is None:
        return
    spelt = bracketed.group(1)
    unit_in_title = UNITS.get(spelt.lower(), spelt)
    try:
        agree = same_dimension(unit_in_title, unit) and abs(factor(unit_in_title) / factor(unit) - 1.0) < 1e-3
    except InputError:
        return
    if not agree:
        cure = f"Use unit='{unit_in_title}', or correct the column title."
        raise InputError(where, f"the column title is '{title.strip()}', but unit='{unit}' is given", "one unit", cure)


def _table(path: str | os.PathLike[str]) -> tuple[np.ndarray, list[int], list[str], str]:
    """Return all numbers of a file (line, column), their line numbers, the titles above the first line, and a date stamp.

    Dates and times of day in the first column become zeros in the table; the first of them is the stamp.
    """
    rows: list[list[float]] = []
    numbers: list[int] = []
    titles: list[str] = []
    first_stamp = ""
    for number, line in enumerate(lines_of(path), start=1):
        text = line.strip()
        if stamp := _STAMP.match(text):
            first_stamp = first_stamp or stamp[1]
            text = f"0{text[stamp.end() :]}"
        if not text or text.startswith(("#", "%")) or (not rows and _is_header(text)):
            titles = titles if rows else _titles(text)
            continue
        if _EMPTY_CELL.search(text):
            cure = "Fill the cell, or remove its column: otherwise later cells would move to earlier columns."
            raise InputError(f"{path}, line {number}", "an empty cell", "a number in every cell", cure)
        row = numbers_of(path, [_in_columns(text)], first_line=number)
        if rows and len(row) != len(rows[0]):
            came = f"{len(row)} column{'' if len(row) == 1 else 's'}"
            raise InputError(
                f"{path}, line {number}", came, f"{len(rows[0])}, as in the lines before", "Check for an empty cell."
            )
        rows.append(list(row))
        numbers.append(number)
    if len(rows) < 2:
        raise InputError(f"{path}", f"{len(rows)} lines of numbers", "two or more lines")
    return np.array(rows), numbers, titles, first_stamp


def _titles(text: str) -> list[str]:
    """Split a line into column titles, separated by semicolons, commas, tabs or two spaces."""
    return [word for word in re.split(r";|,|\t|\s{2,}", text.lstrip("#% ")) if word.strip()]


def _in_columns(text: str) -> str:
    """Rewrite a line with decimal points, and with spaces between the values.

    Values are separated by semicolons, spaces or commas. A comma in a number is a decimal comma if the line has another
    separator, as in ``0,01; 0,35`` and ``0,01  0,35``, but not in ``0,1``.
    """
    if '"' in text:
        separator = ";" if ";" in re.sub(r'"[^"]*"', "", text) else ","
        cells = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
        return " ".join(cell.strip().replace(",", ".") for cell in cells)
    words = text.split(";") if ";" in text else text.split()
    decimal = ";" in text or (len(words) > 1 and any("," in w for w in words))
    if decimal and all(_MAYBE_DECIMAL_COMMA.fullmatch(word.strip()) for word in words if word.strip()):
        return " ".join(word.strip().replace(",", ".") for word in words)
    return text.replace(",", " ").replace(";", " ")


def _is_header(text: str) -> bool:
    """Whether a line contains a word other than a number; ``nan`` counts as a number here and is rejected later."""
    for word in _in_columns(text).split():
        try:
            float(word)
        except ValueError:
            return True
    return False


def _constant_step(path: str | os.PathLike[str], time: np.ndarray, line_numbers: list[int]) -> float:
    """Return the step of a time column; refuse a column with varying step, and name the first irregular line."""
    steps = np.diff(time)
    dt = float(time[-1] - time[0]) / (time.size - 1)
    # Times may be printed with few digits: deviations in the last digit are allowed, deviations near one time step are not.
    deviation = float(np.abs(time - time[0] - dt * np.arange(time.size)).max())
    if dt <= 0.0 or deviation > ROUNDED_TIME * dt:
        usual = float(np.median(steps))
        irregular = np.flatnonzero(np.abs(steps - usual) > 2.0 * ROUNDED_TIME * abs(usual))
        at = int(irregular[0]) + 1 if irregular.size else int(np.argmin(steps)) + 1
        raise InputError(
            f"{path}, line {line_numbers[at]}",
            f"time {time[at]:.9g} s follows {time[at - 1]:.9g} s, but the usual step is {usual:.6g} s",
            "times that increase by a constant step",
            "Resample the record to a constant step first. If numbers have decimal commas, separate the columns by semicolons.",
        )
    # All times together give the step more precisely than one difference. The error is twice the rounding of the end times.
    resolution = max(2.0 * deviation / (time.size - 1), 1e-12 * dt)
    step = _simplest_fraction(Fraction(dt - resolution), Fraction(dt + resolution))
    return float(step) if step.denominator <= LARGEST_DENOMINATOR else float(f"{dt:.9g}")


def _simplest_fraction(low: Fraction, high: Fraction) -> Fraction:
    """Return the fraction with the smallest denominator in an interval: 1/256 for 0.0039062 to 0.0039063."""
    whole = low.numerator // low.denominator
    if whole == low:
        return low
    if whole + 1 <= high:
        return Fraction(whole + 1)
    return whole + 1 / _simplest_fraction(1 / (high - whole), 1 / (low - whole))
