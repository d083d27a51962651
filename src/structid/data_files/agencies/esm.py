"""ESM, ITACA and AFAD ASCII (DYNA header): lines ``KEY: value``, then one value per line."""

from __future__ import annotations

import re

from structid.core.errors import InputError
from structid.data_files.base import (
    FileChannel,
    FileFormat,
    check_count,
    check_peak,
    check_step,
    last_digit,
)
from structid.data_files.file_content import FileContent, keys, number, numbers
from structid.data_files.unit_spellings import QUANTITIES, UNITS, spelt_unit

_KEY = re.compile(r"^[A-Z][A-Z0-9_/^]*: ?")
"""A line of the header. Values that contain a colon do not count."""
_PEAKS = {"acceleration": ("PGA_CM/S^2", "cm/s^2"), "velocity": ("PGV_CM/S", "cm/s"), "displacement": ("PGD_CM", "cm")}


def recognises(content: FileContent) -> bool:
    """Whether the header has the keys of a DYNA file."""
    return "SAMPLING_INTERVAL_S:" in content.head or content.line(0).startswith("EVENT_NAME:")


def read(content: FileContent) -> list[FileChannel]:
    """Read the one channel."""
    last = max((n for n, line in enumerate(content.lines[:120]) if _KEY.match(line)), default=0)
    header = keys(content.lines[: last + 1])
    where = f"{content.path}, lines 1-{last + 1}"
    quantity = header.get("DATA_TYPE", "ACCELERATION").lower()
    if quantity not in QUANTITIES:
        raise InputError(
            where, f"DATA_TYPE: {header['DATA_TYPE']}", "ACCELERATION, VELOCITY or DISPLACEMENT", "Use another file."
        )
    unit = _unit(where, header)
    step = check_step(where, _step(where, header))
    values = numbers(content, last + 1)
    if header.get("NDATA"):
        check_count(where, f"NDATA: {header['NDATA']}", int(number(header["NDATA"], where)), values.size)
    channel = FileChannel(
        name=header.get("STREAM", ""),
        values=values,
        unit=unit,
        dt=step,
        quantity=quantity,
        clock=header.get("DATE_TIME_FIRST_SAMPLE_YYYYMMDD_HHMMSS", ""),
        where=content.at(last + 1),
    )
    peak_key, peak_unit = _PEAKS[quantity]
    if header.get(peak_key) and unit == peak_unit:
        check_peak(channel, number(header[peak_key], where), last_digit(header[peak_key]))
    return [channel]


def _unit(where: str, header: dict[str, str]) -> str:
    """Return the unit of the values; empty if the header has none."""
    spelt = header.get("UNITS", "")
    unit = spelt_unit(spelt)
    if spelt and unit is None:
        raise InputError(
            where, f"UNITS: {spelt}", f"a unit such as {', '.join(list(UNITS)[:4])}", "Correct the header."
        )
    return unit or ""


def _step(where: str, header: dict[str, str]) -> float:
    """Return the sampling interval [s]."""
    text = header.get("SAMPLING_INTERVAL_S", "").replace(",", ".")
    try:
        return float(text)
    except ValueError:
        raise InputError(
            where, f"SAMPLING_INTERVAL_S: {text}", "a time step in seconds", "Complete the header."
        ) from None


FORMAT = FileFormat("ESM, ITACA or AFAD ASCII", recognises, read)
