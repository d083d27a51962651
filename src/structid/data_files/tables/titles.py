"""Titles and units of columns: which header line has them, and which column is the time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from structid.core.errors import InputError
from structid.data_files.tables.dialect import Row
from structid.data_files.unit_spellings import UNITS, seconds_of, spelt_unit

_TIME_WORD = re.compile(
    r"^(?:(?:running|elapsed|total|test|abs\w*|rel\w*)[ _]+)?(time|t|zeit|temps|tiempo|tempo|secs?|seconds)(?=$|[^A-Za-z])",
    re.IGNORECASE,
)
_SQUARE, _ROUND = re.compile(r"\[([^\]]*)\]"), re.compile(r"\(([^)]*)\)")
_BEHIND = re.compile(r"(?:,|\s/|_|\s)\s*([A-Za-z%µ°][\w/^*²%°µ.-]*(?: sec)?)$")
_DIRECTION = re.compile(r"[NSEWXYZHVL]$")
_MOTION_WORD = re.compile(r"^(?:a|v|u|d|acc|vel|dis)", re.IGNORECASE)
_NO_TIME_WORD = re.compile(r"^(?:freq|frequenz|period|f$|hz$)", re.IGNORECASE)

COMMON_UNITS = frozenset(UNITS) | {
    "kn",
    "n",
    "mn",
    "mm",
    "cm",
    "m",
    "kpa",
    "mpa",
    "v",
    "mv",
    "rad",
    "mrad",
    "deg",
    "hz",
    "kg",
}
"""Units that are recognised behind a title without brackets, in lower case."""


class Titles(NamedTuple):
    """Titles and units of the columns, as spelt; empty strings without. The line of the titles counts from 1."""

    titles: list[str]
    units: list[str]
    line: int = 0


def titles_and_units(header: Sequence[Row], columns: int) -> Titles:
    """Find the header line with the titles, and a row of units below it."""
    lines = [(row.line, cells) for row in header if (cells := _cells(row, columns)) is not None]
    if not lines:
        return Titles([""] * columns, [""] * columns)
    unit_row = next((n for n in range(len(lines) - 1, -1, -1) if _is_unit_row(lines[n][1], n > 0)), None)
    above = lines if unit_row is None else lines[:unit_row]
    if unit_row is not None and not above:
        return Titles([""] * columns, _units_of_row(lines[unit_row][1]), lines[unit_row][0])
    telling = [n for n, (_, cells) in enumerate(above) if any(is_time(c) or unit_of_title(c) for c in cells)]
    # A full line of words above the units holds the titles, even if a line above it looks like one.
    full = unit_row is not None and all(re.search("[A-Za-z]", cell) for cell in above[-1][1])
    line, titles = above[telling[-1] if telling and not full else -1]
    units = [unit_of_title(title) for title in titles] if unit_row is None else _units_of_row(lines[unit_row][1])
    return Titles(titles, units, line)


def _units_of_row(cells: Sequence[str]) -> list[str]:
    plain = [cell.strip("()[]{} ") for cell in cells]
    return ["" if cell == "-" else cell for cell in plain]


def _is_unit_row(cells: Sequence[str], has_titles: bool) -> bool:
    """Whether most cells of a header line are units and the others could be: short and without a space.

    A line that may just as well hold titles, such as ``a;b``, needs titles above it, a unit of time, or brackets.
    """
    plain = [cell.strip("()[]{} ") for cell in cells]
    filled = [cell for cell in plain if cell and cell != "-"]
    if not filled or any(" " in cell or len(cell) > 12 for cell in filled):
        return False
    known = [cell for cell in filled if spelt_unit(cell) is not None or seconds_of(cell) is not None]
    if 2 * len(known) < len(filled) or (len(known) < len(filled) and not has_titles):
        return False
    bracketed = any(cell.strip()[:1] in "([{" for cell in cells if cell.strip())
    times = any(seconds_of(cell) is not None for cell in filled)
    return bracketed or (times and len(cells) > 1) or (has_titles and len(cells) > 1)


def unit_of_title(title: str) -> str:
    """Return the unit in a title: in its last brackets, or behind a comma, a slash or an underscore."""
    for pattern in (_SQUARE, _ROUND):
        for text in reversed(pattern.findall(title)):
            word = text.strip()
            numbered = not word or word.isdigit() or re.match(r"(ch|no|nr|pos)\b|.*\d\.?[A-Z]{2}", word, re.IGNORECASE)
            direction = pattern is _ROUND and _DIRECTION.match(word) and _MOTION_WORD.match(title)
            function = pattern is _ROUND and word == "t"
            if not (numbered or direction or function):
                return str(word)
    behind = _BEHIND.search(title.strip())
    if behind is None:
        return ""
    word = behind.group(1)
    is_unit = (
        word.lower() in COMMON_UNITS
        or word.lower() in ("ms", "msec", "us", "µs")
        or (_TIME_WORD.match(title) is not None and seconds_of(word) is not None)
    )
    spaced = title.strip()[: behind.start(1)].endswith(" ") and title.strip()[behind.start()] not in ",/"
    return word if is_unit and not (spaced and _TIME_WORD.match(title) is None) else ""


def is_time(title: str) -> bool:
    """Whether a title names the time: the word, perhaps a number, and perhaps a unit, but nothing else."""
    match = _TIME_WORD.match(title.strip())
    if match is None:
        return False
    rest = re.sub(r"[\[(][^\])]*[\])]", "", title.strip()[match.end() :])
    unit = unit_of_title(title)
    rest = re.sub(re.escape(unit) + r"$", "", rest.strip()) if unit else rest
    return re.fullmatch(r"[\s_.,/:\d#-]*(?:axis|vector|stamp)?\s*", rest, re.IGNORECASE) is not None


def time_factor(where: str, title: str, unit: str) -> float:
    """Return the seconds of the unit of a column of times, one second without a unit; refuse a unit that is not a unit of time."""
    if _NO_TIME_WORD.match(title.strip()):
        raise InputError(
            where, f"the first column is '{title}', which is not a time", "a column of times", "Name it: time_column=1."
        )
    if not unit:
        return 1.0
    factor = seconds_of(unit)
    if factor is None:
        raise InputError(
            where,
            f"the unit '{unit}' of the column '{title or 'of the times'}' is not a unit of time",
            "times in s, ms, µs, min or h",
            "Correct the title, as in 'time [ms]', or name another time_column, or give dt and the column of the values.",
        )
    return factor


def _cells(row: Row, columns: int) -> list[str] | None:
    """Split a header line into as many cells as the table has columns, if that is possible."""
    words = ["" if cell is None else f"{cell:g}" if isinstance(cell, float) else cell.strip() for cell in row.cells]
    if not any(re.search("[A-Za-z%\u00b0]", word) for word in words):
        return None
    by_marks = re.search(r"[\t;,]", row.text) is not None or not row.text
    while len(words) > columns and not words[-1]:
        words.pop()
    if by_marks and len(words) < columns and len(words) == columns - 1 and columns > 2:
        words.append("")
    if len(words) == columns and (by_marks or _are_titles(words)):
        return words
    text = row.text or " ".join(words)
    for pattern in (r"\t", ";", ",", r"\s{2,}", r"(?<=[\])])\s+", r"\s+"):
        cells = [cell.strip(' "') for cell in re.split(pattern, text.strip())]
        while len(cells) > columns and not cells[-1]:
            cells.pop()
        if len(cells) == columns and (pattern != r"\s+" or _are_titles(cells)):
            return cells
    return None


def _are_titles(words: Sequence[str]) -> bool:
    """Whether words that single spaces separate are titles, and not a sentence with as many words."""
    if any(re.fullmatch(r"[\[(].*[\])]", word) or word.endswith((":", "=")) or "=" in word for word in words):
        return all(re.fullmatch(r"[\[(].*[\])]", word) for word in words)
    return True
