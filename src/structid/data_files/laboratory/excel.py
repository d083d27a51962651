"""Excel workbooks (xlsx), read by openpyxl (an extra)."""

from __future__ import annotations

import datetime
import io
from typing import Any

from structid.core.errors import InputError
from structid.data_files.base import FileFormat, optional_library
from structid.data_files.file_content import FileContent
from structid.data_files.tables.column_table import ColumnTable, table_of_rows
from structid.data_files.tables.dialect import MISSING_WORDS, Cell, Row


def recognises(content: FileContent) -> bool:
    """Whether the archive has the parts of a workbook."""
    return content.raw[:4] == b"PK\x03\x04" and b"xl/" in content.raw


def read(content: FileContent) -> ColumnTable:
    """Read the one sheet that has numbers."""
    openpyxl = optional_library(content, "openpyxl", "an Excel workbook", "laboratory")
    try:
        book = openpyxl.load_workbook(io.BytesIO(content.raw), read_only=True, data_only=True)
        sheets = {sheet.title: _rows(sheet) for sheet in book.worksheets}
    except Exception as cause:
        raise InputError(
            content.path, f"openpyxl cannot read it: {cause}", "an xlsx workbook", "Save it again."
        ) from cause
    filled = {name: rows for name, rows in sheets.items() if sum(_has_number(row) for row in rows) > 1}
    if len(filled) != 1:
        came = f"{len(filled)} sheets with numbers: {', '.join(filled)}" if filled else "no sheet with numbers"
        raise InputError(content.path, came, "one sheet with numbers", "Save the sheet of the measurement alone.")
    return table_of_rows(content.path, next(iter(filled.values())))


def _rows(sheet: Any) -> list[Row]:
    """Return the lines of a sheet that have a cell."""
    rows = []
    for number, values in enumerate(sheet.iter_rows(values_only=True), start=1):
        cells = [_cell(value) for value in values]
        while cells and cells[-1] is None:
            cells.pop()
        stamp = str(values[0]) if values and isinstance(values[0], (datetime.datetime, datetime.time)) else ""
        if cells:
            rows.append(Row(number, cells, stamp))
    width = max((len(row.cells) for row in rows if _has_number(row)), default=0)
    # Empty cells at the end of a line are missing values, not a shorter line.
    return [Row(r.line, r.cells + [None] * (width - len(r.cells)), r.stamp) if _has_number(r) else r for r in rows]


def _cell(value: Any) -> Cell:
    if value is None or (isinstance(value, str) and value.strip().lower() in MISSING_WORDS):
        return None
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    if isinstance(value, datetime.timedelta):
        return value.total_seconds()
    return 0.0 if isinstance(value, (datetime.datetime, datetime.time)) else str(value).strip()


def _has_number(row: Row) -> bool:
    return any(isinstance(cell, float) for cell in row.cells) and not any(isinstance(cell, str) for cell in row.cells)


FORMAT = FileFormat("Excel xlsx", recognises, read)
