"""Tables of text files: NumPy reads the body where it is plain, and each line is split where it is not."""

from __future__ import annotations

import itertools

import numpy as np

from structid.data_files.file_content import FileContent
from structid.data_files.tables.column_table import ColumnTable, MoreRows, is_data_row, table_of_rows
from structid.data_files.tables.dialect import Dialect, Row, dialect_of, rows_of_text

HEAD = 200
"""Number of lines at the beginning that are split one by one, for the header."""

HEAD_ROWS = 3
"""Number of rows of numbers in the head, which show a first line with a count."""


def table_of_text(content: FileContent) -> ColumnTable:
    """Read the table of a text file."""
    dialect = dialect_of(content)
    quick = _table_with_plain_body(content, dialect)
    return table_of_rows(content.path, list(rows_of_text(content, dialect))) if quick is None else quick


def _table_with_plain_body(content: FileContent, dialect: Dialect) -> ColumnTable | None:
    """Read a table whose body has numbers only, in lines of one length; None if that is not so."""
    if dialect.point == "thousands" or dialect.comma == "thousands":
        return None
    head = _head(content, dialect)
    if head is None or head[-1].stamp:
        return None
    first = head[-1].line  # index of the line behind the head
    filled = [(number, line) for number, line in enumerate(content.lines[first:], start=first + 1) if line.strip()]
    body = [line for _, line in filled]
    if len(body) < HEAD_ROWS or any('"' in line or "#" in line or "%" in line for line in body):
        return None
    text = body if dialect.comma == "none" else [line.replace(",", ".") for line in body]
    separator = None if dialect.separator == " " else dialect.separator
    try:
        values = np.loadtxt(text, delimiter=separator, comments=None, ndmin=2)
    except ValueError:
        return None
    if values.shape[1] != len(head[-1].cells):
        return None
    return table_of_rows(content.path, head, MoreRows(values, [number for number, _ in filled]))


def _head(content: FileContent, dialect: Dialect) -> list[Row] | None:
    """Return the rows up to the third row of numbers; None if it does not come soon."""
    head: list[Row] = []
    found = 0
    for row in itertools.islice(rows_of_text(content, dialect, HEAD), HEAD):
        head.append(row)
        found += is_data_row(row)
        if found == HEAD_ROWS:
            return head
    return None
