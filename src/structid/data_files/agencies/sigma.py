"""SIGMA ``.cor.acc``: ten lines ``key : value``, then accelerations in m/s² with 14 characters each."""

from __future__ import annotations

import re

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, check_peak, check_step, last_digit, unread
from structid.data_files.file_content import FileContent, fixed_width, keys, number

_HEADER_LINES = 10
_PER_LINE, _WIDTH = 5, 14


def recognises(content: FileContent) -> bool:
    """Whether the header has the keys of this database."""
    return content.line(0).startswith("Event Date & Time") and "Time Increment (s)" in content.head


def read(content: FileContent) -> list[FileChannel]:
    """Read the one channel."""
    header = keys(content.lines[: _HEADER_LINES - 1])
    where = f"{content.path}, lines 1-{_HEADER_LINES}"
    missing = [key for key in ("Time Increment (s)", "Number of Data", "PGA (m/s/s)") if not header.get(key)]
    if missing or re.search(r"m/s/s\s*$", content.line(_HEADER_LINES - 1)) is None:
        what = f"no '{missing[0]}'" if missing else f"'{content.line(_HEADER_LINES - 1).strip()}'"
        raise InputError(where, what, "a complete header, with accelerations in m/s/s", "Download the file again.")
    count = number(header["Number of Data"], where)
    values, after = fixed_width(content, _HEADER_LINES, int(count), _PER_LINE, _WIDTH)
    content.refuse_rest(after)
    channel = FileChannel(
        name=header.get("Orientation", ""),
        values=values,
        unit="m/s^2",
        dt=check_step(where, number(header["Time Increment (s)"], where)),
        quantity="acceleration",
        where=content.at(_HEADER_LINES),
    )
    check_peak(channel, number(header["PGA (m/s/s)"], where), last_digit(header["PGA (m/s/s)"]))
    return [channel]


def is_spectrum(content: FileContent) -> bool:
    """Whether the file is a table of spectral accelerations."""
    return re.match(r"^\s*per\w*\s*\(s\)\s*psa", content.line(0), re.IGNORECASE) is not None


FORMAT = FileFormat("SIGMA", recognises, read)
SPECTRA = FileFormat(
    "SIGMA", is_spectrum, unread("the values are response spectra", "Use the .cor.acc file of this record.")
)
