"""CWA (Taiwan, formerly CWB): time and three components in gal, whose order and sign the header states."""

from __future__ import annotations

import re

import numpy as np

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, check_peak, check_same, check_step, last_digit
from structid.data_files.file_content import FileContent, fixed_width, keys, number
from structid.data_files.time_axis import constant_step

_COMPONENT = re.compile(r"([UNE])\s*\(\s*([+-])\s*\)", re.IGNORECASE)
_PER_LINE, _WIDTH = 4, 10


def recognises(content: FileContent) -> bool:
    """Whether the header has the keys of this network."""
    return "#DataSequence" in content.head.replace(" ", "") and "#AmplitudeUnit" in content.head.replace(" ", "")


def read(content: FileContent) -> list[FileChannel]:
    """Read the three components; a component with the sign (-) is turned."""
    first = next(n for n, line in enumerate(content.lines) if line.strip() and not line.lstrip().startswith("#"))
    header = {key.replace(" ", ""): value for key, value in keys(content.lines[:first]).items()}
    where = f"{content.path}, lines 1-{first}"
    if not header["AmplitudeUnit"].lower().startswith("gal"):
        raise InputError(where, f"the unit '{header['AmplitudeUnit']}'", "gal", "Download the file again.")
    sequence = _COMPONENT.findall(header["DataSequence"])
    if len(sequence) != _PER_LINE - 1 or not header["DataSequence"].strip().lower().startswith("time"):
        raise InputError(
            where, f"DataSequence '{header['DataSequence']}'", "Time U(+); N(+); E(+)", "Repair the header."
        )
    last = len(content.lines)
    while not content.line(last - 1).strip():
        last -= 1
    values, _ = fixed_width(content, first, (last - first) * _PER_LINE, _PER_LINE, _WIDTH)
    rows = values.reshape(-1, _PER_LINE)
    step = _step(content, header, where, rows, first)
    channels = []
    for n, (direction, sign) in enumerate(sequence, start=1):
        channel = FileChannel(
            name=direction.upper(),
            values=rows[:, n] if sign == "+" else -rows[:, n],
            unit="cm/s^2",
            number=n,
            dt=step,
            start=float(rows[0, 0]),
            quantity="acceleration",
            clock=header.get("StartTime(GMT+08)", "") and f"{header['StartTime(GMT+08)']} GMT+08",
            where=content.at(first),
            notes=() if sign == "+" else ("the file has the opposite sign: it is turned",),
        )
        if (peaks := header.get(f"AmplitudeMAX.{direction.upper()}")) is not None:
            extremes = [word.strip() for word in peaks.split("~")]
            largest = max(extremes, key=lambda word: abs(number(word, where)))
            check_peak(channel, number(largest, where), last_digit(largest))
        channels.append(channel)
    return channels


def _step(content: FileContent, header: dict[str, str], where: str, rows: np.ndarray, first: int) -> float:
    """Return the time step [s]; rate, printed times and length must agree."""
    rate = number(header.get("SampleRate(Hz)", "0"), where)
    step = check_step(where, 1.0 / rate if rate else 0.0)
    printed = constant_step(rows[:, 0], lambda n: content.at(first + n), rounding=0.0005)
    check_same(where, "time step", step, printed, 1e-3 * step + 0.001 / len(rows))
    length = number(header.get("RecordLength(sec)", "0"), where)
    check_same(where, "length of the record", len(rows) * step, length, 1.5 * step)
    return step


FORMAT = FileFormat("CWA", recognises, read)
