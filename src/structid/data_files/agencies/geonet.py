"""GeoNet V1A and V2A (GNS Science, New Zealand): three components in a file, in mm and s."""

from __future__ import annotations

import re
from functools import partial

from structid.core.errors import InputError
from structid.data_files.base import (
    FileChannel,
    FileFormat,
    channel_blocks,
    check_peak,
    check_same,
    check_step,
    last_digit,
)
from structid.data_files.file_content import FileContent, fixed_width, number

_FIRST_LINE = re.compile(r"^\s*(un)?corrected accelerogram\b.*", re.IGNORECASE)
_TEXT_LINES, _INTEGER_LINES, _REAL_LINES = 16, 4, 6
_PER_LINE, _WIDTH = 10, 8
_STEP = (2, 5)
"""Line and column of the time step in the real-valued header."""

_BLOCKS = (("acceleration", "mm/s^2"), ("velocity", "mm/s"), ("displacement", "mm"))


def recognises(content: FileContent) -> bool:
    """Whether the first line is that of a file of GNS Science."""
    return _FIRST_LINE.match(content.line(0)) is not None and "GNS" in content.line(0)


def read(content: FileContent) -> list[FileChannel]:
    """Read all components: accelerations, and in a V2A file velocities and displacements."""
    return channel_blocks(content, partial(_component, content))


def _component(content: FileContent, start: int, order: int) -> tuple[list[FileChannel], int]:
    """Read one component."""
    stop = start + _TEXT_LINES
    content.require("first line of a component, 'Corrected accelerogram'", _FIRST_LINE.pattern, start, start + 1)
    _, name = content.require("component, 'Component N10E'", r"^component\s+(\S+)", start, stop)
    line, count = content.require("number of points", r"number of points\s+(\d+)", start, stop)
    points, where = int(count.group(1)), content.at(line)
    step_line, printed = content.require(
        "time step", r"(?:intervals of\s+([\d.]+)\s+s|data at\s+([\d.]+)\s+sec)", start, stop
    )
    printed_step = printed.group(1) or printed.group(2)
    integers, headers = fixed_width(content, stop, _INTEGER_LINES * _PER_LINE, _PER_LINE, _WIDTH)
    reals, first = fixed_width(content, headers, _REAL_LINES * _PER_LINE, _PER_LINE, _WIDTH)
    step = check_step(where, float(reals[_PER_LINE * _STEP[0] + _STEP[1]]))
    check_same(
        content.at(step_line),
        "time step",
        step,
        number(printed_step, content.at(step_line)),
        0.51 * last_digit(printed_step),
    )
    _check_units(content, start, stop, step_line)
    counts = [int(n) for n in integers[3 * _PER_LINE + 3 : 3 * _PER_LINE + 6]]  # of the three blocks
    check_same(where, "number of points", counts[0], points, 0.0)
    channels: list[FileChannel] = []
    for (quantity, unit), values_in_block in zip(_BLOCKS, counts, strict=True):
        if values_in_block:
            values, after = fixed_width(content, first, values_in_block, _PER_LINE, _WIDTH)
            channel = FileChannel(name.group(1), values, unit, order, step, quantity=quantity, where=content.at(first))
            _check_peak(content, start, stop, channel)
            channels.append(channel)
            first = after
    return channels, first


def _check_units(content: FileContent, start: int, stop: int, step_line: int) -> None:
    """Refuse a file in units other than mm and s."""
    line, unit = content.require("unit of the peak", r"^acceleration:?\s+peak\s+\S+\s+(\S+)", start, stop)
    factor = re.search(r"units of\s+([\d.]+)\s+(\S+)", content.line(step_line), re.IGNORECASE)
    if unit.group(1) != "mm/s/s" or (
        factor is not None and (float(factor.group(1)), factor.group(2)) != (1.0, "mm/s/s")
    ):
        raise InputError(
            content.at(line),
            f"'{content.line(line).strip()}'",
            "accelerations in 1.00 mm/s/s",
            "Convert the file to text.",
        )


def _check_peak(content: FileContent, start: int, stop: int, channel: FileChannel) -> None:
    """Compare values with the peak in the header."""
    peak = content.find(rf"^{channel.quantity}:?\s+peak\s+(-?[\d.]+)", start, stop)
    if peak is not None:
        check_peak(channel, number(peak[1].group(1), content.at(peak[0])), last_digit(peak[1].group(1)))


FORMAT = FileFormat("GeoNet V1A or V2A", recognises, read)
