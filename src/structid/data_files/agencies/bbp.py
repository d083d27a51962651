"""SCEC Broadband Platform: comment lines, then time and three components with units in their titles."""

from __future__ import annotations

import re

from structid.core.errors import InputError
from structid.core.units import same_dimension
from structid.data_files.base import FileChannel, FileFormat
from structid.data_files.file_content import FileContent, table
from structid.data_files.time_axis import constant_step
from structid.data_files.unit_spellings import QUANTITIES, spelt_unit

_TITLES = re.compile(r"^\s*[#%]\s*time\s*\(\s*s(?:ec)?\s*\)((?:\s+[\w.-]+\s*\([^)]*\)){3})\s*$", re.IGNORECASE)
_TITLE = re.compile(r"([\w.-]+)\s*\(([^)]*)\)")


def recognises(content: FileContent) -> bool:
    """Whether a comment line names time and three components with units."""
    return any(_TITLES.match(line) for line in content.lines[:40])


def read(content: FileContent) -> list[FileChannel]:
    """Read the three components."""
    line, titles = content.require("titles of the columns", _TITLES.pattern, 0, 40)
    first = next(
        (n for n, text in enumerate(content.lines) if text.strip() and text.strip()[0] not in "#%"), len(content.lines)
    )
    rows = table(content, first, 4)
    if len(rows) < 2:
        raise InputError(
            content.at(line), f"{len(rows)} lines of values", "two or more lines", "Download the file again."
        )
    step = constant_step(rows[:, 0], lambda n: content.at(first + n))
    channels = []
    for n, (name, spelt) in enumerate(_TITLE.findall(titles.group(1)), start=1):
        unit = spelt_unit(spelt) or ""
        quantity = next((q for q, si in QUANTITIES.items() if unit and same_dimension(unit, si)), "")
        channels.append(
            FileChannel(
                name, rows[:, n], unit, n, step, start=float(rows[0, 0]), quantity=quantity, where=content.at(first)
            )
        )
    return channels


FORMAT = FileFormat("SCEC Broadband Platform", recognises, read)
