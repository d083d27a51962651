"""SMC (USGS): one channel, 48 integers and 50 real numbers in the header, columns of ten characters that run together."""

from __future__ import annotations

import re

import numpy as np

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, check_peak, check_step, unread
from structid.data_files.file_content import FileContent, fixed_width

_FIRST_LINE = re.compile(
    r"^\s*([0-6])\s+(unknown|uncorrected|corrected|velocity|displacement|response|fourier)", re.IGNORECASE
)
_TEXT_LINES, _INTEGERS, _REALS = 11, 48, 50
_PER_LINE, _WIDTH = 8, 10
_VERTICAL, _AZIMUTH, _COMMENTS, _VALUES = 12, 13, 15, 16
"""Indices in the integer-valued header: orientation, number of comment lines, number of values."""
_PRECISION, _HIGH_PRECISION = 46, 8
"""Index of the number of significant digits, and its value for columns of 14 characters."""
_RATE, _LARGEST, _SMALLEST = 1, 29, 31
"""Indices in the real-valued header: samples per second, largest and smallest value."""

QUANTITIES = {
    1: ("acceleration", "cm/s^2"),
    2: ("acceleration", "cm/s^2"),
    3: ("velocity", "cm/s"),
    4: ("displacement", "cm"),
}
"""Quantities and units by the number in the first line; 1 is uncorrected, in pairs of time and acceleration."""


def recognises(content: FileContent) -> bool:
    """Whether the first line is that of a history, and the second a star."""
    match = _FIRST_LINE.match(content.line(0))
    return match is not None and int(match.group(1)) in QUANTITIES and content.line(1).lstrip().startswith("*")


def read(content: FileContent) -> list[FileChannel]:
    """Read the one channel."""
    match = _FIRST_LINE.match(content.line(0))
    assert match is not None
    kind = int(match.group(1))
    integers, line = fixed_width(content, _TEXT_LINES, _INTEGERS, _PER_LINE, 10)
    reals, line = fixed_width(content, line, _REALS, 5, 15)
    missing_integer, missing_real = integers[0], reals[0]
    line += int(integers[_COMMENTS]) if integers[_COMMENTS] != missing_integer else 0
    where, count = content.at(line), int(integers[_VALUES])
    pairs = kind == 1 and reals[_RATE] == missing_real
    if count <= 0:
        raise InputError(
            where, f"the header gives {count} values", "a positive number of values", "Download the file again."
        )
    if count % 2 and pairs:
        raise InputError(where, f"{count} values in pairs", "an even number of values", "Download the file again.")
    per_line, width = (5, 14) if integers[_PRECISION] == _HIGH_PRECISION else (_PER_LINE, _WIDTH)
    values, after = fixed_width(content, line, count, per_line, width)
    surplus = pairs and bool(content.line(after).strip())  # these files repeat the end of a buffer in one more line
    content.refuse_rest(after + 1 if surplus else after)
    quantity, unit = QUANTITIES[kind]
    times = values[0::2] if pairs else None
    if times is not None and (np.diff(times) < 0.0).any():
        raise InputError(
            where, "times that decrease", "times that increase", "Download the file again, since it is damaged."
        )
    channel = FileChannel(
        name=_direction(integers[_VERTICAL], integers[_AZIMUTH], missing_integer),
        values=values[1::2] if pairs else values,
        unit=unit,
        dt=None if pairs else check_step(where, 1.0 / reals[_RATE] if reals[_RATE] else 0.0),
        times=times,
        start=0.0 if times is None else float(times[0]),
        quantity=quantity,
        where=where,
        notes=_notes(pairs, surplus),
    )
    peaks = [abs(float(reals[n])) for n in (_LARGEST, _SMALLEST) if reals[n] != missing_real]
    if peaks and not pairs:
        check_peak(channel, max(peaks), 1e-4 * max(peaks))
    return [channel]


def _notes(pairs: bool, surplus: bool) -> tuple[str, ...]:
    """Say what is special in a file of pairs."""
    notes = ("the samples are not at a constant step: points digitised from a film",) if pairs else ()
    return (*notes, "one line after the header's number of values is left out") if surplus else notes


def _direction(vertical: float, azimuth: float, missing: float) -> str:
    """Return the direction of a channel: 0 and 180 degrees from the vertical are up and down."""
    if vertical in (0.0, 180.0):
        return "up" if vertical == 0.0 else "down"
    return "" if azimuth == missing else f"{azimuth:g} deg"


def is_spectrum(content: FileContent) -> bool:
    """Whether the file holds a spectrum."""
    match = _FIRST_LINE.match(content.line(0))
    return match is not None and int(match.group(1)) in (5, 6) and content.line(1).lstrip().startswith("*")


FORMAT = FileFormat("USGS SMC", recognises, read)
SPECTRA = FileFormat("USGS SMC", is_spectrum, unread("the values are spectra", "Use the file of the accelerogram."))
