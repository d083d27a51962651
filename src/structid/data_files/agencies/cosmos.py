"""COSMOS V0, V1 and V2 (format v1.20): integer-valued, real-valued and comment headers whose sizes the file states."""

from __future__ import annotations

import re
from functools import partial

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, channel_blocks, check_peak, check_same, check_step, unread
from structid.data_files.file_content import FileContent, fixed_width, fortran_format

UNITS = {
    **{2: "g", 4: "cm/s^2", 5: "cm/s", 6: "cm", 7: "inch/s^2", 8: "inch/s", 9: "inch", 10: "cm/s^2"},
    **{11: "0.001 g", 12: "1e-6 g"},
}
"""Units by the code of the format's table 2. Codes without an entry, such as 50 for counts, are not physical units."""

QUANTITIES = {1: "acceleration", 2: "velocity", 3: "displacement"}
"""Physical parameters by the code of the format's table 1."""

STEP_MS, LENGTH, LARGEST, MISSING = 61, 62, 63, -999.0
"""Real-valued header: step of this series [ms], its length [s], its largest value; the value for 'unknown'."""
RECORDED_STEP, RECORDED_LENGTH = 33, 34
"""The same of the recording, before it was processed [s]."""
MICROVOLTS_PER_COUNT, VOLTS_PER_G = 21, 41

_FIRST_LINE = re.compile(r"\(\s*format\s+v?\s*0?1\.2\d*\s+with\s+(\d+)\s+text lines\s*\)", re.IGNORECASE)
_CODE = re.compile(r"units\s*=[^,]*\(\s*(\d+)\s*\)", re.IGNORECASE)
_STAGE = {0: "raw", 1: "uncorrected", 2: "corrected", 3: "response spectra"}


def recognises(content: FileContent) -> bool:
    """Whether the first line states the format and its number of text lines."""
    return _FIRST_LINE.search(content.line(0)) is not None


def read(content: FileContent) -> list[FileChannel]:
    """Read all channels; a line that begins with /& or End-of-data ends each."""
    return channel_blocks(content, partial(_channel, content), r"^\s*(/&|end-of-data)")


def _channel(content: FileContent, start: int, order: int) -> tuple[list[FileChannel], int]:
    """Read one channel; its unit follows from a code, its step from the real-valued header."""
    _, first = content.require(
        "first line, '(Format v01.20 with 13 text lines)'", _FIRST_LINE.pattern, start, start + 1
    )
    line = start + int(first.group(1))
    integers, line = _header(content, line, "integer", (10, 8))
    reals, line = _header(content, line, "real", (5, 15))
    _, comments = content.require("number of comment lines", r"^\s*(\d+)\s+comment line", line, line + 1)
    line += 1 + int(comments.group(1))
    _, data = content.require(
        "number of points, '42000 acceleration pts'", r"^\s*(\d+)\s+.*\b(?:pts|points)\b", line, line + 1
    )
    where, points, code = content.at(line), int(data.group(1)), int(integers[2])
    printed_code = _CODE.search(content.line(line))
    if printed_code is not None:
        check_same(where, "unit's code", code, int(printed_code.group(1)), 0.0)
    if integers[1] not in QUANTITIES or not points:
        stage = _STAGE.get(int(integers[0]), f"stage {integers[0]:g}")
        raise InputError(
            where,
            f"data of the type {integers[1]:g}, {stage}",
            "accelerations, velocities or displacements",
            "Use the acceleration file of this record.",
        )
    step = _step(where, points, reals)
    values, after = fixed_width(content, line + 1, points, *(fortran_format(content.line(line)) or (8, 10)))
    channel = FileChannel(
        name=_direction(content, start, start + int(first.group(1))),
        values=values,
        unit=UNITS.get(code, "counts" if code == 50 else f"unit of the code {code}"),
        number=order,
        dt=step,
        quantity=QUANTITIES[int(integers[1])],
        clock=_clock(content, start, start + int(first.group(1))),
        where=content.at(line + 1),
        notes=_notes(code, reals),
    )
    if reals[LARGEST] != MISSING and code in UNITS:
        check_peak(channel, float(reals[LARGEST]), 1e-6)
    return [channel], after


def _step(where: str, points: int, reals: list[float]) -> float:
    """Return the time step [s]: that of this series in ms, or else that of the recording in s; the length must agree."""
    of_series = reals[STEP_MS] > 0.0
    step = check_step(where, 1e-3 * reals[STEP_MS] if of_series else reals[RECORDED_STEP])
    length = reals[LENGTH] if of_series else reals[RECORDED_LENGTH]
    if length > 0.0:
        check_same(where, "length of the record", points * step, length, max(2.0 * step, 1e-3 * length))
    return step


def _header(content: FileContent, line: int, kind: str, usual: tuple[int, int]) -> tuple[list[float], int]:
    """Read an integer- or real-valued header, whose size and format its first line states."""
    _, match = content.require(
        f"size of the {kind}-valued header", rf"^\s*(\d+)\s+{kind}-header values", line, line + 1
    )
    form = fortran_format(content.line(line)) or usual
    values, after = fixed_width(content, line + 1, int(match.group(1)), *form)
    if len(values) < 100:
        raise InputError(content.at(line), f"{len(values)} {kind}-header values", "100", "Download the file again.")
    return list(values), after


def _direction(content: FileContent, start: int, stop: int) -> str:
    """Return the direction of the channel from the text header."""
    line = content.find(r"^\s*sta\s+cha\w*[^:]*:\s*(?:\d+\s*:)?\s*(.*?)\s*(?:\(|location|$)", start, stop)
    return line[1].group(1) if line is not None else ""


def _clock(content: FileContent, start: int, stop: int) -> str:
    """Return the time of the first sample from the text header."""
    line = content.find(r"^\s*rcrd start time\s*:\s*(.*?)\s*(?:\(|rcrdid|$)", start, stop)
    return line[1].group(1) if line is not None else ""


def _notes(code: int, reals: list[float]) -> tuple[str, ...]:
    """Say what a count is, if the header has the recorder's resolution and the sensor's sensitivity."""
    resolution, sensitivity = reals[MICROVOLTS_PER_COUNT], reals[VOLTS_PER_G]
    if code != 50 or resolution <= 0.0 or sensitivity <= 0.0:
        return ()
    # g per count = (µV per count) 1e−6 / (V per g)
    return (
        f"by the header's {resolution:g} µV a count and {sensitivity:g} V/g a count is {1e-6 * resolution / sensitivity:.6g} g",
    )


def is_spectrum(content: FileContent) -> bool:
    """Whether the file is a COSMOS V3 file."""
    return recognises(content) and re.search(r"response|spectr", content.line(0), re.IGNORECASE) is not None


def is_other_version(content: FileContent) -> bool:
    """Whether the file names COSMOS, but its first line is not that of version 1.20."""
    return re.search(r"cosmos\s+format|\(\s*format\s+v\s*\d", content.head, re.IGNORECASE) is not None


FORMAT = FileFormat("COSMOS V0, V1 or V2", recognises, read)
SPECTRA = FileFormat(
    "COSMOS V3",
    is_spectrum,
    unread("the values are response spectra", "Use the V1 or V2 file of this record."),
)
OTHER_VERSIONS = FileFormat(
    "COSMOS",
    is_other_version,
    unread("the first line is not that of version 1.20", "Use the file of version 1.20, or convert it to text."),
)
