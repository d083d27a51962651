"""BHRC (Iran): uncorrected accelerograms at a constant step, in G/10."""

from __future__ import annotations

from functools import partial

from structid.data_files.base import FileChannel, FileFormat, channel_blocks, check_same, check_step
from structid.data_files.file_content import FileContent, fixed_width, number

_HEADER_LINES = 27
_TEXT_LINES, _INTEGER_LINES = 13, 7
_WIDTH = 13


def recognises(content: FileContent) -> bool:
    """Whether the first line names a file of volume 1, and a later one the unit G/10."""
    return "VOL1DS" in content.line(0).upper() and "G/10" in content.head.upper()


def read(content: FileContent) -> list[FileChannel]:
    """Read all components; a line that begins with /& ends each."""
    return channel_blocks(content, partial(_component, content), r"^\s*/&")


def _component(content: FileContent, start: int, order: int) -> tuple[list[FileChannel], int]:
    """Read one component; its step follows from the duration and from the samples per second."""
    stop = start + _TEXT_LINES
    content.require("first line of a component, '* VOL1DS FILE'", r"vol1ds", start, start + 1)
    _, name = content.require("component, 'COMP L1'", r"^\s*comp\s+(\S+)", start, stop)
    content.require("units, 'SECONDS AND G/10'", r"seconds? and g/10", start, stop)
    line, header = content.require(
        "number of points and duration", r"no\. of points\s*=\s*(\d+)\s+duration\s*=\s*([\d.]+)", start, stop
    )
    where, points = content.at(line), int(header.group(1))
    rate_line = start + _TEXT_LINES + _INTEGER_LINES + 1
    rate = number(content.line(rate_line)[:13], content.at(rate_line))
    step = check_step(where, 1.0 / rate if rate else 0.0)
    check_same(where, "duration", points * step, number(header.group(2), where), 1.5 * step)
    first = start + _HEADER_LINES
    per_line = -(-len(content.line(first).rstrip()) // _WIDTH)  # 6 or 10 values in a line
    values, after = fixed_width(content, first, points, max(per_line, 1), _WIDTH)
    channel = FileChannel(name.group(1), values, "0.1 g", order, step, quantity="acceleration", where=content.at(first))
    return [channel], after


FORMAT = FileFormat("BHRC", recognises, read)
