"""NSMN/AFAD (Turkey): one file with three components in gal."""

from __future__ import annotations

import re

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, check_count, check_peak, check_step, last_digit
from structid.data_files.file_content import FileContent, keys, number, table

_COLUMNS = re.compile(r"^\s*(N-?S|E-?W|U-?D)\s+(N-?S|E-?W|U-?D)\s+(N-?S|E-?W|U-?D)\s*$", re.IGNORECASE)
_PEAK = re.compile(r"\((N-?S|E-?W|U-?D)\)\s*([\d.]+)")
_LAST_HEADER_LINE = 30


def recognises(content: FileContent) -> bool:
    """Whether the header has the keys of this network."""
    return "SAMPLING INTERVAL (SEC)" in content.head.upper() and "RAW PGA VALUES" in content.head.upper()


def read(content: FileContent) -> list[FileChannel]:
    """Read the three components, in the order of their titles."""
    line, titles = content.require("titles 'N-S E-W U-D'", _COLUMNS.pattern, 0, _LAST_HEADER_LINE)
    header = {key.upper(): value for key, value in keys(content.lines[:line]).items()}
    where = f"{content.path}, lines 1-{line + 1}"
    if "RAW PGA VALUES (GAL)" not in header or not header.get("NUMBER OF DATA", "").isdigit():
        raise InputError(where, "no unit (gal) or no number of data", "a complete header", "Download the file again.")
    step = check_step(where, number(header["SAMPLING INTERVAL (SEC)"], where))
    values = table(content, line + 1, 3)
    check_count(where, f"NUMBER OF DATA : {header['NUMBER OF DATA']}", int(header["NUMBER OF DATA"]), len(values))
    if len(set(titles.groups())) < 3:
        raise InputError(
            content.at(line), f"titles '{content.line(line).strip()}'", "three directions", "Repair the titles."
        )
    peaks = dict(_PEAK.findall(header["RAW PGA VALUES (GAL)"].upper()))
    channels = []
    for n, title in enumerate(titles.groups()):
        first = content.at(line + 1)
        channel = FileChannel(title.upper(), values[:, n], "cm/s^2", n + 1, step, quantity="acceleration", where=first)
        if title.upper() in peaks:
            check_peak(channel, number(peaks[title.upper()], where), last_digit(peaks[title.upper()]))
        channels.append(channel)
    return channels


FORMAT = FileFormat("NSMN/AFAD", recognises, read)
