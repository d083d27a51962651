"""The cells of text columns: separators, decimal commas, thousands separators, quotes, empty cells."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from structid.core.errors import InputError
from structid.data_files.file_content import FileContent

Cell = float | str | None
"""A cell of a table: a number, a word, or None for a missing value."""

MISSING_WORDS = frozenset(
    {
        "",
        "-",
        "--",
        "---",
        "na",
        "n/a",
        "#n/a",
        "nan",
        "-nan",
        "null",
        "none",
        "*",
        "**",
        "***",
        "-nan(ind)",
        "1.#qnan",
        "-1.#ind",
    }
)
"""Cells that stand for a missing value, in lower case."""

_DATE = r"(?:\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.](?:\d{1,2}|[A-Za-z]{3})[-/.]\d{4})"
_CLOCK = (
    r"\d{1,2}:\d{2}(?::\d{2}(?:\.\d+|,\d+(?=[;\t\s]))?)?(?:\s?[AaPp]\.?[Mm]\.?(?![A-Za-z])|Z|[+-]\d{2}:?\d{2}(?!\d))?"
)
STAMP = re.compile(rf'"?({_DATE}(?:[T ]+{_CLOCK}|"?[;,\t]"?{_CLOCK})?|{_CLOCK})"?(?=[\s;,]|$)')
"""A date, a time of day, or both, at the start of a line."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
_MAYBE_DECIMAL_COMMA = re.compile(r"[-+]?(\d+|\d*[.,]\d+|\d+[.,])([eEdD][-+]?\d+)?")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+")
_ANY_LETTER, _DIGIT = re.compile(r"[^\W\d_]"), re.compile(r"\d")
_DECIMAL_COMMA = re.compile(r"(?<![\d,.])(?:0\d*,|\d{4,},|\d{1,3},(?!\d{3}(?!\d)))")
"""A comma that separates no group of thousands, as in 0,125 and 12,5."""
_OTHER_ROLES = re.compile(r",\d*[.,]\d"), re.compile(r"\.\d*,\d")
"""Two marks in one number, as in 1,234.5, which show their roles."""
FIRST_LINES, LAST_LINES = 400, 100
"""Numbers of lines that show how cells are separated."""

_BOTH = re.compile(r"[-+]?\d[\d.,]*(?:[eEdD][-+]?\d+)?")
_LETTER = re.compile(r"[A-Za-z\u00c0-\u024f]{2,}|\b[A-Za-z]\b")


class Row(NamedTuple):
    """A line of a table: its number from 1, and its cells."""

    line: int
    cells: list[Cell]
    stamp: str = ""  # a date or a time of day in the first cell
    text: str = ""  # the line, for titles
    comment: bool = False  # whether a comment mark begins the line


class Dialect(NamedTuple):
    """How the lines of a file separate cells and write numbers."""

    separator: str  # ";", tab, ",", or a space for any white space
    comma: str  # role of a comma in a number: "decimal", "thousands" or "none"
    point: str  # role of a point in a number: "decimal" or "thousands"


def rows_of_text(content: FileContent, dialect: Dialect, lines: int | None = None) -> Iterator[Row]:
    """Split the lines of a text file, or the first of them, into cells; comment marks are dropped, blank lines left out."""
    for number, line in enumerate(content.lines[:lines], start=1):
        text = line.strip(" \r\n")
        if not text.strip():
            continue
        if text.startswith(("#", "%")):
            yield Row(number, [text.lstrip("#% \t")], text=text.lstrip("#% \t"), comment=True)
            continue
        text, stamp = _without_stamp(text)
        cells = split(text, dialect.separator)
        yield Row(number, [_cell(cell, dialect, content.at(number - 1)) for cell in cells], stamp, text)


def _without_stamp(text: str) -> tuple[str, str]:
    """Replace a date or a time of day at the start of a line by a zero, and return it."""
    match = STAMP.match(text)
    if match is None:
        return text, ""
    between = re.search(r"[;,\t]", match[1])  # a date and a time of day in two cells
    zero = "0" if between is None else f"0{between[0]}0"
    return f"{zero}{text[match.end() :]}", match[1]


def dialect_of(content: FileContent) -> Dialect:
    """Find the separator from the first and last lines without words, and the role of commas and points from all."""
    lines = content.lines
    sample = lines if len(lines) <= FIRST_LINES + LAST_LINES else lines[:FIRST_LINES] + lines[-LAST_LINES:]
    separator = _separator(list(_without_words(sample)) or [line for line in sample if _DIGIT.search(line)])
    if separator == "," and '"' not in "".join(sample):
        _refuse_single_decimal_commas(content, sample)
        return Dialect(separator, "none", "decimal")
    body = list(_without_words(lines))
    text = "\n".join(body)
    if "," not in text:
        return Dialect(separator, "none", "decimal")
    if (
        separator != ","
        and "." not in text
        and _DECIMAL_COMMA.search(text)
        and not any(roles.search(text) for roles in _OTHER_ROLES)
    ):
        return Dialect(separator, "decimal", "decimal")
    numbers = _BOTH.findall(text) if separator != "," else [cell for text in body for cell in split(text, ",")]
    return Dialect(separator, *_roles(content, [number for number in numbers if "," in number or "." in number]))


def _refuse_single_decimal_commas(content: FileContent, sample: Sequence[str]) -> None:
    """Refuse lines such as ``0,10``, which may be one number or two, in a file that does not show which."""
    body = [line.strip() for line in _without_words(sample)]
    titles = any("," in line for line in sample if _ANY_LETTER.search(line))
    if body and not titles and all(re.fullmatch(r"[-+]?\d+,\d+", line) for line in body):
        raise InputError(
            content.path,
            f"'{body[0]}' may be one number with a decimal comma, or two numbers",
            "lines whose comma has one meaning",
            "Export the file with decimal points, or with semicolons between the columns.",
        )


def _without_words(lines: Sequence[str]) -> Iterator[str]:
    """Return the lines that have digits and no words."""
    for line in lines:
        if _ANY_LETTER.search(line) is None:
            text = _without_stamp(line.strip(" \r\n"))[0]
        else:
            text = _without_stamp(line.strip(" \r\n"))[0]
            if _LETTER.search(_numbers_only(text)):
                continue
        if _DIGIT.search(text):
            yield text


def _numbers_only(text: str) -> str:
    """Remove exponents and missing values, so that only the letters of words remain."""
    text = re.sub(r"(?<=[\d.])[eEdD](?=[-+]?\d)", "", text)
    return " ".join(word for word in re.split(r"[\s;,\"]+", text) if word.lower() not in MISSING_WORDS)


def _separator(body: Sequence[str]) -> str:
    """Return the separator of the cells: semicolon, tab, comma, or white space."""
    bare = [re.sub(r'"[^"]*"', '""', text) for text in body]
    for candidate in (";", "\t"):
        if bare and sum(candidate in text.strip(" ") for text in bare) > 0.5 * len(bare):
            return candidate
    if not any("," in text for text in bare):
        return " "
    # A comma in words that spaces separate is a decimal comma, as in "0,01  0,35"; else it separates, as in "0,1" or "0, 1".
    words = [text.split() for text in bare]
    decimal = all(all(_MAYBE_DECIMAL_COMMA.fullmatch(word) for word in line) for line in words)
    several = any(len(line) > 1 for line in words)
    # Thousands, as in "0.01 1,234.5": both marks in a word.
    numbers = all(all(_BOTH.fullmatch(word) and not word.endswith(",") for word in line) for line in words)
    return " " if several and (decimal or numbers) else ","


def split(text: str, separator: str) -> list[str]:
    """Split a line into cells; cells in quotes may contain the separator."""
    if '"' in text:
        delimiter = separator if separator != " " else (";" if ";" in re.sub(r'"[^"]*"', "", text) else ",")
        return [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))]
    if separator == " ":
        return text.split()
    return [cell.strip() for cell in text.split(separator)]


def _roles(content: FileContent, cells: Sequence[str]) -> tuple[str, str]:
    """Return the roles of comma and point in numbers: both roles must be the same in the whole file."""
    numbers = [cell for cell in cells if _BOTH.fullmatch(cell)]
    both = [cell for cell in numbers if "," in cell and "." in cell]
    comma_only = [cell for cell in numbers if "," in cell and "." not in cell]
    point_only = [cell for cell in numbers if "." in cell and "," not in cell]
    if both:
        last = {cell[max(cell.rfind(","), cell.rfind("."))] for cell in both}
        if len(last) > 1:
            raise InputError(
                content.path,
                f"'{both[0]}' and other numbers use comma and point differently",
                "one decimal mark",
                "Export the file with one decimal mark.",
            )
        return ("thousands", "decimal") if last == {"."} else ("decimal", "thousands")
    if not comma_only:
        return "none", "decimal"
    grouped = [bool(_THOUSANDS.fullmatch(cell)) for cell in comma_only]
    if any(cell.count(",") > 1 for cell in comma_only) or (point_only and all(grouped)):
        return "thousands", "decimal"
    thousands = [cell for cell in point_only if re.fullmatch(r"[-+]?[1-9]\d{0,2}(\.\d{3})+", cell)]
    if thousands and len(thousands) == len(point_only):
        raise InputError(
            content.path,
            f"the number '{thousands[0]}' may be {thousands[0].replace('.', '')} or {thousands[0]}, beside '{comma_only[0]}'",
            "numbers whose point has one meaning",
            "Export the file with decimal points and without thousands separators.",
        )
    if all(grouped):
        raise InputError(
            content.path,
            f"the number '{comma_only[0]}' may be {comma_only[0].replace(',', '')} or {comma_only[0].replace(',', '.')}",
            "numbers whose comma has one meaning",
            "Export the file with decimal points and without thousands separators.",
        )
    return "decimal", "decimal"


def _cell(text: str, dialect: Dialect, where: str) -> Cell:
    """Convert a cell to a number, None for a missing value, or a word."""
    if text.lower() in MISSING_WORDS:
        return None
    if "," in text and _BOTH.fullmatch(text):
        if dialect.comma == "thousands" and not re.fullmatch(r"[-+]?\d{1,3}(,\d{3})+(\.\d*)?", text):
            raise InputError(
                where, f"the number '{text}'", "thousands in groups of three digits", "Correct the number."
            )
        if dialect.comma == "decimal" and dialect.point == "thousands":
            text = text.replace(".", "")
        text = text.replace(",", "" if dialect.comma == "thousands" else ".")
    elif dialect.point == "thousands" and "." in text and _BOTH.fullmatch(text):
        if re.fullmatch(r"[-+]?[1-9]\d{0,2}(\.\d{3})+", text) is None:
            raise InputError(
                where, f"the number '{text}'", "thousands in groups of three digits", "Correct the number."
            )
        text = text.replace(".", "")
    return _float(text)


def _float(text: str) -> Cell:
    """Convert a number; a word stays a word, and so do infinities and Python's 1_000."""
    try:
        value = float(text)
    except ValueError:
        return float(re.sub("[dD]", "e", text)) if re.fullmatch(_NUMBER, text) else text
    return value if math.isfinite(value) and "_" not in text else text
