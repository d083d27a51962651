"""CSMNC (China Strong Motion Networks Centre): one component in cm/s²; the header has count, step, peak and duration."""

from __future__ import annotations

from structid.data_files.base import (
    FileChannel,
    FileFormat,
    check_count,
    check_peak,
    check_same,
    check_step,
    last_digit,
)
from structid.data_files.file_content import FileContent, number, spaced_numbers

_HEADER_LINES = 16
_PER_LINE, _WIDTH = 8, 13


def recognises(content: FileContent) -> bool:
    """Whether the header states points at equally spaced intervals, in the words of this centre."""
    return "EQUALLY SPACED INTERVALS OF" in content.head.upper() and "PEAK VALUE" in content.head.upper()


def read(content: FileContent) -> list[FileChannel]:
    """Read the one component."""
    _, component = content.require("component, 'COMP. EW'", r"^\s*comp\.?\s+(\S+)", 0, _HEADER_LINES)
    content.require("unit, 'CM/SEC/SEC'", r"acceleration\s+unit\s*:\s*cm/sec/sec", 0, _HEADER_LINES)
    line, points = content.require(
        "number of points and step",
        r"no\. of points\s*:\s*(\d+)\s+equally spaced intervals of\s*:\s*([\d.]+)\s*sec",
        0,
        _HEADER_LINES,
    )
    where, count = content.at(line), int(points.group(1))
    step = check_step(where, number(points.group(2), where))
    peak_line, peak = content.require(
        "peak and duration", r"peak value\s*:\s*(-?[\d.]+).*duration\s*:\s*([\d.]+)\s*sec", 0, _HEADER_LINES
    )
    check_same(where, "duration", count * step, number(peak.group(2), where), max(1.0, step))
    clock = content.find(r"recorder time\s*:\s*(.*?)\s*$", 0, _HEADER_LINES)
    values = spaced_numbers(content, _HEADER_LINES, _PER_LINE, _WIDTH)
    check_count(where, f"NO. OF POINTS: {count}", count, values.size)
    channel = FileChannel(
        name=component.group(1),
        values=values,
        unit="cm/s^2",
        dt=step,
        quantity="acceleration",
        clock=clock[1].group(1) if clock is not None else "",
        where=content.at(_HEADER_LINES),
    )
    check_peak(channel, number(peak.group(1), content.at(peak_line)), last_digit(peak.group(1)))
    return [channel]


FORMAT = FileFormat("CSMNC", recognises, read)
