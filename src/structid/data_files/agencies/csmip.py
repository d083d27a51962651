"""CSMIP/CISN (California): uncorrected (V1) and corrected (V2) accelerograms, several channels in a file."""

from __future__ import annotations

import re
from functools import partial

from structid.core.errors import InputError
from structid.data_files.agencies.volume1 import INTEGER_LINES, REAL_LINES, channel_of_pairs
from structid.data_files.base import (
    FileChannel,
    FileFormat,
    channel_blocks,
    check_count,
    check_peak,
    check_same,
    check_step,
    last_digit,
    unread,
)
from structid.data_files.file_content import FileContent, fixed_width, fortran_format, number

_FIRST_LINE = re.compile(r"^\s*(un)?corrected accelerogram", re.IGNORECASE)
_V1_TEXT_LINES = 13
_V2_HEADER_LINES, _V2_REALS, _V2_STEP = 13, 100, 60
"""Lines of V2's real-valued header, its values, and the index of the time step among them."""

_CLOCK = r"(?:start|trigger) time:\s*(.*?)\s*(?:\(|$)"
_CHANNEL = r"^\s*chan\.?\s*(\d+)\s*:\s*(.*?)\s*(?:\(|from\b|location|\s{3}|$)"
_POINTS_V1 = (
    r"^\s*(\d+)\s+(?:accelerogram points at\s+([\d.]+)\s+pts/sec in units of\s+"
    r"|points of accel data equally spaced at\s+([\d.]+)\s+sec\.?\s+\(units:\s*)g\b"
)
_POINTS_V2 = r"^\s*(\d+)\s+points of (accel|veloc|displ)\w* data equally spaced at\s+([\d.]+)\s+sec"
_PEAK_V1 = r"units of uncor.*max\s*=\s*(-?[\d.]+)\s*g\b"
_PEAK_V2 = r"peak\s+acceleration\s*=\s*(-?[\d.]+)\s+cm/sec/sec"
QUANTITIES = {
    "accel": ("acceleration", "cm/s^2"),
    "veloc": ("velocity", "cm/s"),
    "displ": ("displacement", "cm"),
}
"""Quantities of the three blocks of a corrected channel, and their units."""


def recognises(content: FileContent) -> bool:
    """Whether the first line is that of a V1 or V2 file."""
    return _FIRST_LINE.match(content.line(0)) is not None


def read(content: FileContent) -> list[FileChannel]:
    """Read all channels; a line that begins with /& ends each."""
    return channel_blocks(content, partial(_channel, content), r"^\s*/&", end_required=True)


def _channel(content: FileContent, start: int, _: int) -> tuple[list[FileChannel], int]:
    """Read one channel, whose first line tells whether it is corrected."""
    match = _FIRST_LINE.match(content.line(start))
    if match is None:
        raise InputError(
            content.at(start),
            f"'{content.line(start).strip()[:40]}'",
            "the first line of a channel, 'Uncorrected accelerogram' or 'Corrected accelerogram'",
            "Download the file again, since lines are missing or doubled.",
        )
    return (_uncorrected if match.group(1) else _corrected)(content, start)


def _name(content: FileContent, start: int) -> tuple[int, str]:
    """Return number and direction of a channel: the channel number of the station if the file states it."""
    line, match = content.require("channel, 'Chan 1: 90 Deg'", _CHANNEL, start, start + 10)
    station = re.search(r"sta chn\s*:\s*(\d+)", content.line(line), re.IGNORECASE)
    return int(station.group(1) if station is not None else match.group(1)), match.group(2)


def _clock(content: FileContent, start: int) -> str:
    """Return the start or trigger time of a channel."""
    line = content.find(_CLOCK, start, start + 10)
    return line[1].group(1) if line is not None else ""


def _uncorrected(content: FileContent, start: int) -> tuple[list[FileChannel], int]:
    """Read a V1 channel: equally spaced values in g since about 2000, pairs in seconds and G/10 before."""
    number_of_channel, name = _name(content, start)
    _, declared = content.require("number of points", r"no\. of points\s*=\s*(\d+)", start, start + _V1_TEXT_LINES)
    headers = start + _V1_TEXT_LINES + INTEGER_LINES + REAL_LINES
    new = content.find(_POINTS_V1, headers, headers + 1)
    if new is None:
        content.require("units, 'sec and g/10'", r"units.*sec and g/10", start, start + _V1_TEXT_LINES)
        channel, after = channel_of_pairs(content, headers, int(declared.group(1)), name, number_of_channel)
        _check_peak(content, start, _PEAK_V1, channel, 10.0)
        return [channel], after
    line, match = new
    where, points = content.at(line), int(match.group(1))
    check_count(where, f"No. of Points = {declared.group(1)}", int(declared.group(1)), points)
    form = fortran_format(content.line(line)) or (8, 9)
    values, after = fixed_width(content, line + 1, points, *form)
    _, rate = content.require("samples per second", r"at\s+([\d.]+)\s+samples/sec", start, start + _V1_TEXT_LINES)
    step = check_step(where, 1.0 / number(rate.group(1), where))
    if match.group(2):
        check_same(where, "samples per second", number(rate.group(1), where), number(match.group(2), where), 0.0)
    else:
        check_same(where, "time step", step, number(match.group(3), where), 0.51 * last_digit(match.group(3)))
    channel = FileChannel(
        name,
        values,
        "g",
        number_of_channel,
        step,
        quantity="acceleration",
        clock=_clock(content, start),
        where=content.at(line + 1),
    )
    _check_peak(content, start, _PEAK_V1, channel)
    return [channel], after


def _corrected(content: FileContent, start: int) -> tuple[list[FileChannel], int]:
    """Read a V2 channel: blocks of acceleration, velocity and displacement."""
    number_of_channel, name = _name(content, start)
    channels: list[FileChannel] = []
    index, _ = content.require("number of points of acceleration", _POINTS_V2, start + 20, start + 60)
    step = _step_of_header(content, index)
    while (block := content.find(_POINTS_V2, index, index + 1)) is not None:
        match = block[1]
        points, printed = int(match.group(1)), match.group(3)
        check_same(content.at(index), "time step", step, number(printed, content.at(index)), 0.51 * last_digit(printed))
        form = fortran_format(content.line(index)) or (8, 10)
        values, after = fixed_width(content, index + 1, points, *form)
        quantity, unit = QUANTITIES[match.group(2).lower()]
        clock, where = _clock(content, start), content.at(index + 1)
        channels.append(
            FileChannel(name, values, unit, number_of_channel, step, quantity=quantity, clock=clock, where=where)
        )
        index = after
    _check_peak(content, start, _PEAK_V2, channels[0])
    return channels, index


def _check_peak(content: FileContent, start: int, pattern: str, channel: FileChannel, times: float = 1.0) -> None:
    """Compare the values with the peak in the header of a channel, multiplied by a factor."""
    peak = content.find(pattern, start, start + 30)
    if peak is not None:
        printed = peak[1].group(1)
        check_peak(channel, times * number(printed, content.at(peak[0])), times * last_digit(printed))


def _step_of_header(content: FileContent, points_line: int) -> float:
    """Return the time step [s] in the real-valued header; the text headers round it to 0.001 s."""
    reals, _ = fixed_width(content, points_line - _V2_HEADER_LINES, _V2_REALS, 8, 10)
    return check_step(content.at(points_line - _V2_HEADER_LINES), float(reals[_V2_STEP]))


def is_spectrum(content: FileContent) -> bool:
    """Whether the file is a V3 file."""
    return re.match(r"^\s*response (and|spectr)", content.line(0), re.IGNORECASE) is not None


FORMAT = FileFormat("CSMIP V1 or V2", recognises, read)
SPECTRA = FileFormat(
    "CSMIP V3",
    is_spectrum,
    unread("the values are response spectra", "Use the V1 or V2 file of this record."),
)
