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
"""Formats recognised by their first lines and not supported."""


ROUNDED_TIME = 0.05
"""Largest error of a printed time, in steps."""
LARGEST_DENOMINATOR = 100_000
"""Largest denominator of a time step as a fraction of a second; no instrument's clock needs a larger one."""

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
                f"a file in the format {name}, which is not read",
                "PEER AT2, ESM ASCII, or text with a time and an acceleration column",
                "Convert it, or cut out its accelerations, one a line: GroundMotion.read(path, dt=0.01, unit='cm/s^2').",
            )
    if unit is None:
        raise InputError(
            f"{path}",
            "no unit was given for a text file",
            "unit='g', 'm/s^2', 'cm/s^2', …",
            "Give the unit of the values: GroundMotion.read(path, unit='g').",
        )
    _, step, values = read_columns(path, unit, dt, column, "m/s^2")
    return values[:, 0], step


class Columns(NamedTuple):
    """Columns of a text file, sampled at a constant step."""

    start: float  # Time of the first line [s]; 0 in a file without times
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
    """Read a signal from text columns: time and value, or values alone with a given time step."""
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
                f"{table.shape[1]} columns, and column {index} asked for",
                f"column 0 to {table.shape[1] - 1}",
                "A file with a single column needs dt.",
            )
    start = 0.0 if dt is not None else float(table[0, 0])
    step = _constant_step(path, table[:, 0], numbers) if dt is None else dt
    by = factor(unit) if si_unit is None else factor_of(unit, si_unit, f"{path}: unit")
    if len(titles) == table.shape[1]:
        for index in columns:
            _check_unit_of_title(f"{path}, line {numbers[0] - 1}", titles[index], unit)
    return Columns(start, step, table[:, columns] * by)


def _column(path: str | os.PathLike[str], table: np.ndarray, numbers: list[int], dt: float | None, others: int) -> int:
    """The column of the values, if it is unambiguous."""
    columns, where = table.shape[1], f"{path}, line {numbers[0]}"
    wrapped = "Where the record goes on from line to line, write it with one value a line, and give dt."
    if dt is not None and columns > 1 + others:
        allowed = f"column=0 to {columns - 1}, or one value a line"
        cure = f"{wrapped} A time column needs no dt."
        raise InputError(where, f"{columns} values a line, a time step, and no column named", allowed, cure)
    if columns > 2 + others:
        allowed = f"column=1 to {columns - 1}, the time being column 0"
        raise InputError(where, f"{columns} values a line, and no column named", allowed, wrapped)
    return 0 if dt is not None else 1


def _check_unit_of_title(where: str, title: str, unit: str) -> None:
    """Refuse a unit that contradicts the bracketed unit in the column's title."""
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
        cure = f"Leave it at unit='{unit_in_title}', or correct the head of the column."
        raise InputError(where, f"the column is called '{title.strip()}', and unit='{unit}' is given", "one unit", cure)


def _table(path: str | os.PathLike[str]) -> tuple[np.ndarray, list[int], list[str], str]:
    """All numbers of a file (line, column), their line numbers, the titles above the first line, and a date stamp.

    Dates and times of day in the first column are zeros in the table; the first of them is the stamp.
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
            cure = "Fill it, or leave its column out: cells after it would be taken for those before."
            raise InputError(f"{path}, line {number}", "an empty cell", "a number in every cell", cure)
        row = numbers_of(path, [_in_columns(text)], first_line=number)
        if rows and len(row) != len(rows[0]):
            came = f"{len(row)} column{'' if len(row) == 1 else 's'}"
            raise InputError(
                f"{path}, line {number}", came, f"{len(rows[0])}, as in the lines before", "Is a cell empty?"
            )
        rows.append(list(row))
        numbers.append(number)
    if len(rows) < 2:
        raise InputError(f"{path}", f"{len(rows)} lines of numbers", "two or more")
    return np.array(rows), numbers, titles, first_stamp


def _titles(text: str) -> list[str]:
    """Column titles, separated by semicolons, commas, tabs or two spaces."""
    return [word for word in re.split(r";|,|\t|\s{2,}", text.lstrip("#% ")) if word.strip()]


def _in_columns(text: str) -> str:
    """A line with its values separated by spaces, and with decimal points.

    Values are separated by semicolons, spaces or commas. A comma inside a number is decimal where another separator is used:
    ``0,01; 0,35`` and ``0,01  0,35``, but not ``0,1``.
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
    """Whether a line contains a word that is not a number; ``nan`` counts as a number and is rejected later."""
    for word in _in_columns(text).split():
        try:
            float(word)
        except ValueError:
            return True
    return False


def _constant_step(path: str | os.PathLike[str], time: np.ndarray, line_numbers: list[int]) -> float:
    """The step of a time column; refuses a column with varying step and names the first such line."""
    steps = np.diff(time)
    dt = float(time[-1] - time[0]) / (time.size - 1)
    # Times may be printed with few digits: a deviation of the last digit is allowed, one near a sample is not.
    deviation = float(np.abs(time - time[0] - dt * np.arange(time.size)).max())
    if dt <= 0.0 or deviation > ROUNDED_TIME * dt:
        usual = float(np.median(steps))
        irregular = np.flatnonzero(np.abs(steps - usual) > 2.0 * ROUNDED_TIME * abs(usual))
        at = int(irregular[0]) + 1 if irregular.size else int(np.argmin(steps)) + 1
        raise InputError(
            f"{path}, line {line_numbers[at]}",
            f"time {time[at]:.9g} s after {time[at - 1]:.9g} s, where the step is {usual:.6g} s elsewhere",
            "times that increase by a constant step",
            "Resample the record to a constant step first. Where decimals have commas, put semicolons between the columns.",
        )
    # All times together know the step better than one difference: to twice the rounding of the first and the last one.
    resolution = max(2.0 * deviation / (time.size - 1), 1e-12 * dt)
    step = _simplest_fraction(Fraction(dt - resolution), Fraction(dt + resolution))
    return float(step) if step.denominator <= LARGEST_DENOMINATOR else float(f"{dt:.9g}")


def _simplest_fraction(low: Fraction, high: Fraction) -> Fraction:
    """Fraction with the smallest denominator in an interval, by continued fractions: 1/256 for 0.0039062 to 0.0039063."""
    whole = low.numerator // low.denominator
    if whole == low:
        return low
    if whole + 1 <= high:
        return Fraction(whole + 1)
    return whole + 1 / _simplest_fraction(1 / (high - whole), 1 / (low - whole))
