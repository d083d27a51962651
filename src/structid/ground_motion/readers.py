"""Readers of accelerograms: PEER AT2 in its newer and older headers, and columns of text."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from structid.errors import InputError
from structid.units import STANDARD_GRAVITY, to_si

_NEW_HEADER = re.compile(r"NPTS\s*=\s*(\d+)\s*,?\s*DT\s*=\s*([\d.]+(?:[eE][-+]?\d+)?)", re.IGNORECASE)
_OLD_HEADER = re.compile(r"^\s*(\d+)\s+([\d.]+(?:[eE][-+]?\d+)?)\s+.*NPTS\s*,\s*DT", re.IGNORECASE)


def read_peer(path: str | os.PathLike[str]) -> tuple[np.ndarray, float, str]:
    """Read a PEER ``.AT2`` file: four header lines, the third or fourth with count and step, then values in g.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    tuple of ndarray, float and str
        Acceleration [m/s²], time step [s], and the header's event line.

    Raises
    ------
    InputError
        If the file is empty, has no such header, a value that is no number, or another count than it says.
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
            "For plain columns give the reader dt or a time column: GroundMotion.read(path, dt=0.01, unit='g').",
        )
    count, dt = int(match.group(1)), float(match.group(2))
    values = _numbers(path, lines[number + 1 :], first_line=number + 2)
    if values.size != count:
        raise InputError(
            f"{path}, line {number + 1}",
            f"the header says NPTS = {count}, and {values.size} values follow",
            "as many values as the header says",
            "The file is cut short or damaged: fetch it again.",
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
    """Read a signal from text columns: time and value, or value alone with a given step.

    Parameters
    ----------
    path : path-like
        Text or CSV; lines that start with a letter or ``#`` are headers.
    unit : str
        Unit of the values, such as ``"g"`` or ``"mm/s"``.
    dt : float, optional
        Time step [s]; when left out, the first column is the time [s].
    column : int, optional
        Which column holds the values, counted from 0; by default the second with a time column, else the first.
    si_unit : str, optional
        What `unit` must measure, such as ``"m/s^2"``.
    from_zero : bool
        Refuse times that do not start at zero.

    Returns
    -------
    tuple of ndarray and float
        Values in SI and the time step [s].

    Raises
    ------
    InputError
        If the file is empty, a value is no number, or the step of the time column is not constant.
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
            "With a single column give dt.",
        )
    if dt is None:
        dt = _constant_step(path, table[:, 0], numbers)
        if from_zero and abs(table[0, 0]) > 0.5 * dt:
            raise InputError(
                f"{path}, line {numbers[0]}",
                f"the first time is {table[0, 0]:g} s",
                "times that start at 0 s, with the record",
                "Cut the history to the record's start, or shift its times.",
            )
    by = to_si(1.0, unit, f"{path}: unit") if si_unit is None else to_si(f"1 {unit}", si_unit, f"{path}: unit")
    return table[:, index] * by, dt


def _is_header(text: str) -> bool:
    """Whether a line holds anything but numbers; ``nan`` is a number, and a wrong one."""
    for word in text.replace(",", " ").replace(";", " ").split():
        try:
            float(word)
        except ValueError:
            return True
    return False


def _constant_step(path: str | os.PathLike[str], time: np.ndarray, line_numbers: list[int]) -> float:
    steps = np.diff(time)
    dt = (time[-1] - time[0]) / (time.size - 1)
    # Times printed with few digits: a step may be off by one unit of the last digit, not by a sample.
    wrong = np.flatnonzero(np.abs(time - time[0] - dt * np.arange(time.size)) > 0.05 * abs(dt))
    if dt <= 0 or wrong.size:
        at = wrong[0] if wrong.size else int(np.argmin(steps))
        raise InputError(
            f"{path}, line {line_numbers[at]}",
            f"time {time[at]:g} s breaks the constant step of {dt:g} s",
            "times that rise by a constant step",
            "Resample the record to a constant step first.",
        )
    # The mean over all samples carries the digits that single printed times lack.
    return float(f"{dt:.9g}")


def _lines(path: str | os.PathLike[str]) -> list[str]:
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{path}", "there is no such file", "a readable file", "Check the name and the folder.")
    text = file.read_bytes().decode("utf-8", errors="replace")
    # Files that went through several systems end their lines in \r\r\n; the numbering is that of \n.
    lines = [line.strip("\r") for line in (text.split("\n") if "\n" in text else text.split("\r"))]
    if not any(line.strip() for line in lines):
        raise InputError(f"{path}", "the file is empty", "a record", "Fetch it again.")
    return lines


def _numbers(path: str | os.PathLike[str], lines: list[str], first_line: int) -> np.ndarray:
    values: list[float] = []
    for number, line in enumerate(lines, start=first_line):
        for word in line.split():
            try:
                value = float(word)
            except ValueError:
                raise InputError(f"{path}, line {number}", f"'{word}' is no number", "numbers") from None
            if not np.isfinite(value):
                raise InputError(
                    f"{path}, line {number}",
                    f"'{word}'",
                    "finite numbers",
                    "Repair the record: a gap must not be guessed at.",
                )
            values.append(value)
    return np.array(values)
