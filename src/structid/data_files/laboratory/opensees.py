"""Recorders of OpenSees: XML, and binary rows that end in a line feed. Text recorders are text columns."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from structid.core.errors import InputError
from structid.data_files.base import FileFormat
from structid.data_files.file_content import FileContent
from structid.data_files.tables.column_table import ColumnTable

_MOST_COLUMNS = 2000


def is_xml(content: FileContent) -> bool:
    """Whether the file is XML with the root element of OpenSees."""
    return content.raw[:5] == b"<?xml" and b"<OpenSees" in content.raw[:400]


def read_xml(content: FileContent) -> ColumnTable:
    """Read the columns, and their titles from the elements before the data."""
    try:
        root = ElementTree.fromstring(content.raw)
    except ElementTree.ParseError as cause:
        raise InputError(
            content.path,
            f"the XML is damaged: {cause}",
            "a complete file",
            "End the analysis with wipe(), which closes the file.",
        ) from None
    titles: list[str] = []
    for element in root:
        if element.tag != "Data":
            tag = next((value for name, value in element.attrib.items() if name.endswith("Tag")), "")
            kind = {"NodeOutput": "node", "ElementOutput": "element"}.get(element.tag, "")
            titles.extend(f"{kind} {tag} {response.text}".strip() for response in element.iter("ResponseType"))
    text = next((element.text for element in root if element.tag == "Data"), None) or ""
    lines = [line.split() for line in text.strip().splitlines()]
    if len(lines) < 2 or any(len(line) != len(titles) for line in lines):
        raise InputError(
            content.path,
            f"{len(lines)} lines, {len(titles)} titles",
            "as many values per line as titles",
            "Run the analysis again.",
        )
    first = content.raw[: content.raw.index(b"<Data")].count(b"\n") + 2
    try:
        values = np.array(lines, dtype=float)
    except ValueError as cause:
        raise InputError(
            content.path, f"a value is no number: {cause}", "numbers", "The analysis has diverged."
        ) from None
    return ColumnTable(content.path, values, list(range(first, first + len(values))), titles, [""] * len(titles), 1)


def columns_of_binary(content: FileContent) -> int:
    """Return the number of columns if the file is made of rows of doubles, each with a line feed behind it; 0 if not."""
    size = len(content.raw)
    raw = np.frombuffer(content.raw, dtype=np.uint8)
    for columns in range(1, _MOST_COLUMNS + 1):
        row = 8 * columns + 1
        if 2 * row > size:
            return 0
        if size % row == 0 and (raw[row - 1 :: row] == 10).all():
            return columns
    return 0


def is_binary(content: FileContent) -> bool:
    """Whether the file is binary and made of such rows."""
    return content.is_binary and columns_of_binary(content) > 0


def read_binary(content: FileContent) -> ColumnTable:
    """Read the rows; OpenSees writes no titles."""
    columns = columns_of_binary(content)
    rows = np.frombuffer(content.raw, dtype=np.uint8).reshape(-1, 8 * columns + 1)[:, :-1]
    values = np.ascontiguousarray(rows).view("<f8")
    return ColumnTable(content.path, values, list(range(1, len(values) + 1)), [""] * columns, [""] * columns)


XML = FileFormat("OpenSees XML recorder", is_xml, read_xml)
BINARY = FileFormat("OpenSees binary recorder", is_binary, read_binary)
