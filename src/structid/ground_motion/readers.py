"""Readers of accelerograms: PEER AT2 files with the newer or the older header, and text files with columns."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from structid.errors import InputError
from structid.units import STANDARD_GRAVITY, to_si

_NEW_HEADER = re.compile(r"NPTS\s*=\s*(\d+)\s*,?\s*DT\s*=\s*([\d.]+(?:[eE][-+]?\d+)?)", re.IGNORECASE)
_OLD_HEADER = re.compile(r"^\s*(\d+)\s+([\d.]+(?:[eE][-+]?\d+)?)\s+.*NPTS\s*,\s*DT", re.IGNORECASE)


def read_acceleration(
    path: str | os.PathLike[str], dt: float | None = None, unit: str | None = None, column: int | None = None
) -> tuple[np.ndarray, float]:
    """Read a ground acceleration from a PEER ``.AT2`` file, or from a text file with columns.

    Parameters
    ----------
    path : path-like
        The file; the extension ``.at2`` marks a PEER file.
    dt : float, optional
        Time step [s] of a text file without a time column.
    unit : str, optional
        Unit of the values of a text file; AT2 files are in g.
    column : int, optional
        Column of the values in a text file, counted from 0.

    Returns
    -------
    tuple of ndarray and float
        Acceleration [m/s²] and time step [s].

    Raises
    ------
    InputError
        If the file cannot be read as such a record, or a text file comes without a unit.
    """
    if Path(path).suffix.lower() == ".at2":
        return read_peer(path)[:2]
    if unit is None:
        raise InputError(
            f"{path}",
            "no unit was given for a text file",
            "unit='g', 'm/s^2', 'cm/s^2', …",
            "Give the unit of the values: GroundMotion.read(path, unit='g').",
        )
    return read_columns(path, unit, dt, column, "m/s^2")


def read_peer(path: str | os.PathLike[str]) -> tuple[np.ndarray, float, str]:
    """Read a PEER ``.AT2`` file: four header lines, the third or fourth with count and step, then values in g.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    tuple of ndarray, float and str
        Acceleration [m/s²], time step [s], and the event line of the header.

    Raises
    ------
    InputError
        If the file is empty, has no such header, holds a value that is not a number, or a different number of values than its
        header gives.
    """
    lines = _lines(path)
    matches = [_NEW_HEADER.search(line) or _OLD_HEADER.search(line) for line in lines[:6]]
    number = next((i for i, found in enumerate(matches) if found), -1)
    match = matches[number] if number >= 0 else None
    if match is None:
        raise InputError(
            f"{path}, lines 1-6",
            "no line with NPTS and DT",
            "a PEER AT2 header such as 'NPTS= 4000, DT= .0100'",
            "Columns of text need a time column or dt: GroundMotion.read(path, dt=0.01, unit='g').",
        )
    count, dt = int(match.group(1)), float(match.group(2))
    values = _numbers(path, lines[number + 1 :], first_line=number + 2)
    if values.size != count:
        raise InputError(
            f"{path}, line {number + 1}",
            f"the header says NPTS = {count}, and {values.size} values follow",
            "as many values as the header says",
            "The file is cut short or damaged: download it again.",
        )
    event = lines[1].strip() if number >= 2 else Path(path).stem
    return values * STANDARD_GRAVITY, dt, event


def read_columns(
    path: str | os.PathLike[str],
    unit: str,
    dt: float | None = None,
    column: int | None = None,
    si_unit: str | None = None,
    from_zero: bool = False,
) -> tuple[np.ndarray, float]:
    """Read a signal from text columns: time and value, or values alone with a given time step.

    Parameters
    ----------
    path : path-like
        Text or CSV. Lines that start with ``#`` or ``%`` are skipped, and so are header lines before the first numbers.
    unit : str
        Unit of the values, such as ``"g"`` or ``"mm/s"``.
    dt : float, optional
        Time step [s]; without it, the first column is the time [s].
    column : int, optional
        Column of the values, counted from 0; by default the second where there is a time column, else the first.
    si_unit : str, optional
        SI unit with the dimension that `unit` must have, such as ``"m/s^2"``.
    from_zero : bool
        Reject times that do not start at zero.

    Returns
    -------
    tuple of ndarray and float
        Values in SI and the time step [s].

    Raises
    ------
    InputError
        If the file is empty, a value is not a number, or the step of the time column is not constant.
    """
    rows: list[list[float]] = []
    numbers: list[int] = []
    for number, line in enumerate(_lines(path), start=1):
        text = line.strip()
        if not text or text.startswith(("#", "%")) or (not rows and _is_header(text)):
            continue
        row = _numbers(path, [text.replace(",", " ").replace(";", " ")], first_line=number)
        if rows and len(row) != len(rows[0]):
            raise InputError(f"{path}, line {number}", f"{len(row)} columns", f"{len(rows[0])}, as in the lines before")
        rows.append(list(row))
        numbers.append(number)
    if len(rows) < 2:
        raise InputError(f"{path}", f"{len(rows)} lines of numbers", "two or more")
    table = np.array(rows)
    index = (0 if dt is not None else 1) if column is None else column
    if not 0 <= index < table.shape[1]:
        raise InputError(
            f"{path}",
            f"{table.shape[1]} columns, and column {index} asked for",
            f"column 0 to {table.shape[1] - 1}",
            "A file with a single column needs dt.",
        )
    if dt is None:
        dt = _constant_step(path, table[:, 0], numbers)
        if from_zero and abs(table[0, 0]) > 0.5 * dt:
            raise InputError(
                f"{path}, line {numbers[0]}",
                f"the first time is {table[0, 0]:g} s",
                "times that start at 0 s, like the record",
                "Cut the history to the start of the record, or shift its times.",
            )
    by = to_si(1.0, unit, f"{path}: unit") if si_unit is None else to_si(f"1 {unit}", si_unit, f"{path}: unit")
    return table[:, index] * by, dt


def _is_header(text: str) -> bool:
    """Whether a line holds a word that is not a number; ``nan`` counts as a number and is rejected later."""
    for word in text.replace(",", " ").replace(";", " ").split():
        try:
            float(word)
        except ValueError:
            return True
    return False


def _constant_step(path: str | os.PathLike[str], time: np.ndarray, line_numbers: list[int]) -> float:
    steps = np.diff(time)
    dt = (time[-1] - time[0]) / (time.size - 1)
    # Times may be printed with few digits: a deviation of the last digit is allowed, one near a sample is not.
    wrong = np.flatnonzero(np.abs(time - time[0] - dt * np.arange(time.size)) > 0.05 * abs(dt))
    if dt <= 0 or wrong.size:
        at = wrong[0] if wrong.size else int(np.argmin(steps))
        raise InputError(
            f"{path}, line {line_numbers[at]}",
            f"time {time[at]:g} s breaks the constant step of {dt:g} s",
            "times that increase by a constant step",
            "Resample the record to a constant step first.",
        )
    # The mean over all samples has the digits that single printed times lack.
    return float(f"{dt:.9g}")


def _lines(path: str | os.PathLike[str]) -> list[str]:
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{path}", "there is no such file", "a readable file", "Check the name and the folder.")
    text = file.read_bytes().decode("utf-8", errors="replace")
    # Files copied between systems may end their lines in \r\r\n; lines are counted by \n.
    lines = [line.strip("\r") for line in (text.split("\n") if "\n" in text else text.split("\r"))]
    if not any(line.strip() for line in lines):
        raise InputError(f"{path}", "the file is empty", "a record", "Download it again.")
    return lines


def _numbers(path: str | os.PathLike[str], lines: list[str], first_line: int) -> np.ndarray:
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
