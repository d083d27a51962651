"""K-NET and KiK-net ASCII (NIED, Japan): 17 header lines, then counts of the digitizer."""

from __future__ import annotations

import re

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, check_count, check_peak, check_step, last_digit
from structid.data_files.file_content import FileContent, number, spaced_numbers

_HEADER_LINES, _PER_LINE, _WIDTH = 17, 8, 9
_SCALE = re.compile(r"([\d.]+)\s*\(gal\)\s*/\s*([\d.]+)", re.IGNORECASE)

DIRECTIONS = {
    **{"N-S": "NS", "E-W": "EW", "U-D": "UD"},
    **{"1": "borehole NS", "2": "borehole EW", "3": "borehole UD"},
    **{"4": "surface NS", "5": "surface EW", "6": "surface UD"},
}
"""Directions of K-NET, and of KiK-net: 1 to 3 in the borehole, 4 to 6 at the surface."""


def recognises(content: FileContent) -> bool:
    """Whether the first line is the origin time, and a later one the scale factor."""
    return content.line(0).startswith("Origin Time") and "Scale Factor" in content.head


def read(content: FileContent) -> list[FileChannel]:
    """Read the one channel: counts times the scale factor, less their mean, as the peak of the header is computed."""
    header = {line[:18].strip(): line[18:].strip() for line in content.lines[:_HEADER_LINES]}
    where = f"{content.path}, lines 1-{_HEADER_LINES}"
    for key in ("Sampling Freq(Hz)", "Duration Time(s)", "Dir.", "Scale Factor", "Max. Acc. (gal)"):
        if not header.get(key):
            raise InputError(where, f"the header has no '{key}'", "a complete header", "Download the file again.")
    scale = _SCALE.fullmatch(header["Scale Factor"])
    if scale is None or header["Dir."] not in DIRECTIONS:
        raise InputError(
            where,
            f"Scale Factor '{header['Scale Factor']}', Dir. '{header['Dir.']}'",
            "a factor such as '3920(gal)/6182761', and a direction such as 'N-S' or '4'",
            "Download the file again.",
        )
    frequency = number(re.sub("hz$", "", header["Sampling Freq(Hz)"], flags=re.IGNORECASE), where)
    counts = spaced_numbers(content, _HEADER_LINES, _PER_LINE, _WIDTH)
    step = check_step(where, 1.0 / frequency if frequency else 0.0)
    duration = number(header["Duration Time(s)"], where)
    check_count(where, f"{duration:g} s at {frequency:g} Hz", round(duration * frequency), counts.size)
    # a = counts × (full scale in gal / counts at full scale), as NIED defines it
    values = counts * (number(scale.group(1), where) / number(scale.group(2), where))
    mean = float(values.mean())
    channel = FileChannel(
        name=DIRECTIONS[header["Dir."]],
        values=values - mean,
        unit="cm/s^2",
        dt=step,
        quantity="acceleration",
        where=content.at(_HEADER_LINES),
        clock=header.get("Record Time", ""),
        notes=(
            f"the mean, {mean:.4g} gal, is subtracted",
            "the record time is 15 s after the first sample, by the delay of the recorder",
        ),
    )
    check_peak(channel, number(header["Max. Acc. (gal)"], where), last_digit(header["Max. Acc. (gal)"]))
    return [channel]


FORMAT = FileFormat("K-NET or KiK-net", recognises, read)
