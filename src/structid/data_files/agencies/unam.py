"""UNAM ASA 2.0 (Mexico): up to twelve channels in gal; order and direction of the channels are free text."""

from __future__ import annotations

import numpy as np

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, check_count, check_peak, check_step, last_digit
from structid.data_files.file_content import FileContent, fixed_width, keys, number

_STARTS = "DATOS DE ACELERACION"
_TITLE_LINES = 12
"""Lines within which the values follow the title of their part."""


def recognises(content: FileContent) -> bool:
    """Whether the header calls itself a standard acceleration file."""
    return "ARCHIVO ESTANDAR DE ACELERACION" in content.head.upper()


def read(content: FileContent) -> list[FileChannel]:
    """Read all channels; steps, counts and peaks are lists separated by slashes."""
    title, _ = content.require("title 'DATOS DE ACELERACION'", rf"^\s*{_STARTS}")
    header = {key.upper(): value for key, value in keys(content.lines[:title]).items()}
    where = f"{content.path}, lines 1-{title + 1}"
    if "GAL" not in header.get("UNIDADES DE LOS DATOS", "").upper():
        raise InputError(where, f"units '{header.get('UNIDADES DE LOS DATOS', '')}'", "Gal", "Download the file again.")
    directions = _list(header, "ORIENTACION")
    steps = [check_step(where, number(step, where)) for step in _list(header, "INTERVALO DE MUESTREO")]
    counts = [int(number(count, where)) for count in _list(header, "NUM. TOTAL DE MUESTRAS")]
    peaks = _list(header, "ACEL. MAX.(GAL)")
    decimation = number(header.get("FACTOR DE DECIMACION") or "1", where)
    channels = int(number(header.get("NUMERO DE CANALES", "0"), where))
    if not len(directions) == len(steps) == len(counts) == channels > 0:
        raise InputError(
            where,
            f"{channels} channels, but {len(directions)} directions, {len(steps)} steps and {len(counts)} counts",
            "one of each for every channel",
            "Download the file again, since its header is damaged.",
        )
    values, first = _values(content, title, channels, max(counts))
    found = []
    for n in range(channels):
        channel = FileChannel(
            name=directions[n],
            values=values[: counts[n], n],
            unit="cm/s^2",
            number=n + 1,
            dt=steps[n] * decimation,
            quantity="acceleration",
            clock=f"{header.get('HORA DE LA PRIMERA MUESTRA (GMT)', '')} GMT".strip(),
            where=content.at(first),
        )
        if not np.isfinite(channel.values).all() or np.isfinite(values[counts[n] :, n]).any():
            check_count(
                where, f"{counts[n]} values of channel {n + 1}", counts[n], int(np.isfinite(values[:, n]).sum())
            )
        if n < len(peaks):
            check_peak(channel, number(peaks[n], where), last_digit(peaks[n]))
        found.append(channel)
    return found


def _list(header: dict[str, str], key: str) -> list[str]:
    """Return the entries of the lines for channels 1 to 6 and 7 to 12, such as ``/V/N90E/N00E``."""
    lines = [
        value
        for name, value in header.items()
        if name.startswith(key) and "MUESTRA" not in name.replace("NUM. TOTAL DE MUESTRAS", "")
    ]
    return [entry.strip() for value in lines for entry in value.split("/")[1:] if entry.strip()]


def _values(content: FileContent, title: int, channels: int, count: int) -> tuple[np.ndarray, int]:
    """Read the columns, whose Fortran format the header states; an empty cell ends a shorter channel."""
    line, form = content.require("format of the data, '3F10.3'", r"formato datos.*:\s*(\d+)F(\d+)\.\d+", 0, title)
    if int(form.group(1)) != channels:
        raise InputError(content.at(line), f"{form.group(1)} values in a line", f"{channels}", "Repair the header.")
    rules = [
        index
        for index in range(title + 1, title + _TITLE_LINES)
        if content.line(index).strip().strip("-+") == "" and content.line(index).strip()
    ]
    if len(rules) < 2:
        raise InputError(
            content.at(title),
            "no titles between two lines of dashes",
            "titles of the channels",
            "Download the file again.",
        )
    first, width = rules[1] + 1, int(form.group(2))
    last = len(content.lines)
    while last > first and not content.line(last - 1).strip():
        last -= 1
    while last - first > count and content.line(last - 1) == content.line(first + count - 1):
        last -= 1  # some files repeat the last sample to the end of a block
    check_count(content.at(first), f"{count} samples", count, last - first)
    values = np.full((count, channels), np.nan)
    for row, index in enumerate(range(first, last)):
        text = content.line(index).ljust(width * channels)
        if len(content.line(index).rstrip()) % width or len(text.rstrip()) > width * channels:
            fixed_width(content, index, channels, channels, width)  # names the fault
        for n in range(channels):
            if cell := text[n * width : (n + 1) * width].strip():
                values[row, n] = number(cell, content.at(index))
    return values, first


FORMAT = FileFormat("UNAM ASA 2.0", recognises, read)
