"""Tables of columns: titles, units, numbers, and which column is the time."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.data_files.tables.dialect import Row
from structid.data_files.tables.titles import is_time, titles_and_units
from structid.data_files.unit_spellings import seconds_of

_SPECTRUM_TITLE = re.compile(r"^(?:per(?:iod)?|freq(?:uency)?)\b|\bp?s[av]\b|spectr", re.IGNORECASE)
WRAPPED_COLUMNS = 4
"""Number of columns from which a table without titles may be one record that goes on from line to line."""


@dataclass(frozen=True, eq=False)
class ColumnTable:
    """A table of numbers; missing cells are NaN."""

    path: str
    values: Float[np.ndarray, "row column"]
    lines: list[int]  # number of the line of each row, from 1
    titles: list[str]  # empty strings without titles
    units: list[str]  # units as spelt in titles or in a row of units; empty strings without
    title_line: int = 0  # number of the line with the titles, from 1; 0 without titles
    stamp: str = ""  # a date or a time of day in the first column
    step: float | None = None  # time step in a first line with count and step [s]
    header: str = ""  # the text above the numbers

    def at(self, row: int) -> str:
        """Name the file and the line of a row, for messages."""
        return f"{self.path}, line {self.lines[row]}"

    def time_columns(self) -> list[int]:
        """Return the columns whose titles say that they are times, or else those whose units do."""
        named = [n for n, title in enumerate(self.titles) if is_time(title) and not self._is_other_quantity(n)]
        return named or [n for n, unit in enumerate(self.units) if unit and seconds_of(unit) is not None]

    def _is_other_quantity(self, column: int) -> bool:
        """Whether a column with a title such as T or T1-1 has a unit that is not a unit of time, such as a temperature."""
        unit = self.units[column]
        return re.match(r"[tT](?![A-Za-z])", self.titles[column]) is not None and bool(
            unit and seconds_of(unit) is None
        )


class MoreRows(NamedTuple):
    """Further rows of a table, without words and missing cells, and the numbers of their lines."""

    values: Float[np.ndarray, "row column"]
    lines: list[int]


def table_of_rows(path: str, rows: Sequence[Row], more: MoreRows | None = None) -> ColumnTable:
    """Make a table: header lines, then rows of numbers; a header that repeats in between begins another block."""
    header: list[Row] = []
    data: list[Row] = []
    again: list[Row] = []  # header lines of a later block
    for row in rows if any(is_data_row(row) for row in rows) else _without_text_columns(rows):
        if _is_data(row, data, header):
            _check_block(path, again, header, data, row)
            again = []
            data.append(row)
        elif data and row.comment:
            continue
        elif data:
            again.append(row)
        else:
            header.append(row)
    if again and any(_words(row) for row in again):
        raise InputError(
            f"{path}, line {again[0].line}",
            f"'{_text(again[0])}' is not a number",
            "numbers",
            "Remove the text after the last value.",
        )
    while len(data) > 1 and not any(isinstance(cell, float) for cell in data[-1].cells):
        data.pop()  # lines of separators at the end, as spreadsheets write them
    if len(data) > 1 and data[0].stamp and not data[1].stamp:
        header.append(data.pop(0))  # a date above the numbers
    step, data = _count_and_step(path, data, 0 if more is None else len(more.lines))
    _check_spectrum(path, header)
    if len(data) < 2:
        raise InputError(path, f"{len(data)} lines of numbers", "two or more lines", _no_numbers(header))
    columns = max(len(row.cells) for row in data)
    for row in data:
        if len(row.cells) != columns:
            _refuse_row(path, row, data)
    values = np.array([[np.nan if cell is None else cell for cell in row.cells] for row in data], dtype=float)
    lines = [row.line for row in data]
    if more is not None:
        values, lines = np.concatenate([values, more.values]), lines + more.lines
    titles, units, title_line = titles_and_units(header, columns)
    if columns > 1 and np.isnan(values[:, -1]).all() and not titles[-1]:
        # a separator behind the last cell of every line
        values = values[:, :-1]
        titles, units, title_line = titles_and_units(header, columns - 1)
    stamp = next((row.stamp for row in data if row.stamp), "")
    return ColumnTable(path, values, lines, titles, units, title_line, stamp, step, _header_text(header))


def _without_text_columns(rows: Sequence[Row]) -> list[Row]:
    """Make the words of columns of words, such as a state or an event, missing values, if every line has one."""
    counts = Counter(len(row.cells) for row in rows if any(isinstance(cell, float) for cell in row.cells))
    usual = counts.most_common(1)[0][0] if counts else 0
    body = [row for row in rows if len(row.cells) == usual and any(isinstance(cell, float) for cell in row.cells)]
    words = {n for n in range(usual) if sum(isinstance(row.cells[n], str) for row in body) > 0.5 * len(body)}
    changed = {id(row) for row in body}
    return [
        row._replace(cells=[None if n in words else cell for n, cell in enumerate(row.cells)])
        if id(row) in changed
        else row
        for row in rows
    ]


def is_data_row(row: Row) -> bool:
    """Whether a row holds numbers only."""
    return all(isinstance(cell, float) for cell in row.cells)


def _is_data(row: Row, data: Sequence[Row], header: Sequence[Row]) -> bool:
    """Whether a row holds numbers or missing values only.

    A row of missing values before the first number is decoration, such as a line of dashes, only below or above a title.
    """
    if any(isinstance(cell, str) for cell in row.cells):
        return False
    if row.stamp and len(row.cells) == 1 and not data:
        return False  # a date above the titles
    if any(isinstance(cell, float) for cell in row.cells):
        return True
    return bool(data) or not any(_words(earlier) for earlier in header)


def _words(row: Row) -> list[str]:
    return [cell for cell in row.cells if isinstance(cell, str) and re.search("[^-=_+|*~ ]", cell)]


def _text(row: Row) -> str:
    return " ".join("" if cell is None else f"{cell:g}" if isinstance(cell, float) else cell for cell in row.cells)[:60]


def _check_block(path: str, again: Sequence[Row], header: Sequence[Row], data: Sequence[Row], row: Row) -> None:
    """Accept another block only behind the header of the first; refuse any other text between numbers."""
    if not again:
        return
    columns = len(data[0].cells)
    titles, units, _ = titles_and_units(header, columns)
    if any(titles) and titles_and_units(again, columns)[:2] == (titles, units) and len(row.cells) == columns:
        return
    strange = next((line for line in again if _words(line)), again[0])
    word = (_words(strange) or [_text(strange)])[0]
    raise InputError(
        f"{path}, line {strange.line}", f"'{word}' is not a number", "numbers", "Correct the line, or split the file."
    )


def _refuse_row(path: str, row: Row, data: Sequence[Row]) -> None:
    usual = len(data[0].cells)
    came = f"{len(row.cells)} column{'' if len(row.cells) == 1 else 's'}"
    if row is data[0]:
        usual, came = len(data[1].cells), f"{came} in the first line of numbers"
    raise InputError(
        f"{path}, line {row.line}",
        came,
        f"{usual}, as in the other lines",
        "Check for an empty cell, or for a count or a time step.",
    )


def _count_and_step(path: str, data: list[Row], more: int) -> tuple[float | None, list[Row]]:
    """Take a first line with the number of values, and perhaps the time step, for what it is.

    The line is recognised by its count. A single value that might be a count or a step is refused.
    """
    if len(data) < 2 or len(data) + more < 3:
        return None, data
    first, rest = data[0].cells, data[1:]
    count = len(rest) + more
    where = f"{path}, line {data[0].line}"
    shorter = len(first) != len(rest[0].cells)
    if first[0] == count and len(first) <= 2 and (shorter or len(first) == 1):
        step = first[1] if len(first) == 2 and isinstance(first[1], float) else None
        return step, rest
    if len(first) == 2 and len(rest[0].cells) == 2 and first[0] == count and first[0] > 2:
        return (first[1] if isinstance(first[1], float) else None), rest
    if shorter and len(first) <= 2 and len({len(row.cells) for row in rest}) == 1:
        raise InputError(
            where,
            f"{len(first)} number{'s' if len(first) > 1 else ''}, '{_text(data[0])}', before {count} lines with "
            f"{len(rest[0].cells)}",
            "the number of the lines that follow, and perhaps the time step",
            "Correct the line, or remove it and give the time step as dt.",
        )
    return None, data


def _check_spectrum(path: str, header: Sequence[Row]) -> None:
    """Refuse a response spectrum."""
    for row in header:
        words = [word for cell in _words(row) for word in re.split(r"[;,\t]|\s{2,}", cell)]
        if (
            words
            and re.match(r"^(per(iod)?|freq(uency)?)\b", words[0].strip(), re.IGNORECASE)
            and any(_SPECTRUM_TITLE.search(word) for word in words[1:])
        ):
            raise InputError(
                f"{path}, line {row.line}",
                f"a spectrum, '{_text(row)}'",
                "a history of samples",
                "Use the file of the history.",
            )


def _header_text(header: Sequence[Row]) -> str:
    return "\n".join(row.text or _text(row) for row in header)


def _no_numbers(header: Sequence[Row]) -> str:
    """Remedy for a file without a table: name a cell that is no number in a line that has some."""
    nearly = max(header, key=lambda row: sum(isinstance(cell, float) for cell in row.cells), default=None)
    if nearly is not None and any(isinstance(cell, float) for cell in nearly.cells) and _words(nearly):
        return (
            f"Line {nearly.line} has the word '{_words(nearly)[0]}'. Dates must be written as 2026-12-31 12:00:00 in the first "
            "column; remove columns of words."
        )
    return "If the file has one of the formats of a network, it is damaged." if len(header) > 5 else ""


def is_wrapped(values: Float[np.ndarray, "row column"]) -> bool:
    """Whether the rows of a table continue one another, as a record printed with several values per line.

    Neighbours in a record differ less than samples that are a whole line apart.
    """
    if values.shape[1] < WRAPPED_COLUMNS or len(values) < 4:
        return False
    along = np.abs(np.diff(values.reshape(-1)))
    down = np.abs(np.diff(values, axis=0))
    return bool(np.nanmedian(along) < 0.5 * np.nanmedian(down))
