"""What a data file holds, and the interface of a file format."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.units import factor
from structid.data_files.file_content import FileContent
from structid.data_files.tables.column_table import ColumnTable
from structid.data_files.unit_spellings import spelt_unit

PEAK_TOLERANCE = 2e-3
"""Relative difference below which a peak agrees with the peak in the header."""


@dataclass(frozen=True, eq=False)
class FileChannel:
    """One channel of a data file: values, time base, and what the file says about them.

    A channel has either a constant time step `dt` or the times of its samples. Missing samples are NaN.
    """

    name: str  # direction or title, as in the file
    values: Float[np.ndarray, " time"]  # in the file's unit
    unit: str  # the file's unit; empty if the file does not state it
    number: int = 1  # number of the channel in the file, from 1
    dt: float | None = None  # time step [s]
    times: Float[np.ndarray, " time"] | None = None  # times of the samples [s], if the step is not constant
    start: float = 0.0  # time of the first sample in the time base of the file [s]
    counted: bool = False  # whether the file has no times, so that they are the numbers of the samples
    quantity: str = ""  # a key of QUANTITIES, or empty
    clock: str = ""  # date and time of the first sample, as the file states them
    where: str = ""  # file and line at which the values begin
    usual_unit: str = ""  # the unit of the format if neither the file nor the user gives one
    notes: tuple[str, ...] = ()  # what was done to the values, or seems wrong in the header

    @property
    def has_unit(self) -> bool:
        """Whether the file states a physical unit; counts of a digitizer are none."""
        return bool(self.unit) and self.unit not in ("counts", "count") and spelt_unit(self.unit) is not None

    @property
    def in_si(self) -> Float[np.ndarray, " time"]:
        """Values in SI; the file must state a unit."""
        return self.values * factor(self.unit)


@dataclass(frozen=True)
class FileFormat:
    """A file format: name, how its files are recognised by their content, and their reader.

    A reader returns channels with units and time steps of their own, or a table of columns.
    """

    name: str
    recognises: Callable[[FileContent], bool]
    read: Callable[[FileContent], list[FileChannel] | ColumnTable]


@dataclass(frozen=True, eq=False)
class DataFile:
    """A file that has been read: its format, and its channels or its table."""

    path: str
    format: str
    channels: list[FileChannel] = field(default_factory=list)
    table: ColumnTable | None = None


def optional_library(content: FileContent, module: str, what: str, extra: str) -> Any:
    """Import a library that only some formats need; say how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(
            content.path,
            f"this is {what}, and the package {module} is not installed",
            f"an installed {module}",
            f"Run: pip install 'structid[{extra}]'.",
        ) from None


def unread(what: str, cure: str) -> Callable[[FileContent], list[FileChannel]]:
    """Reader of a format that structid knows by its name and does not read."""

    def refuse(content: FileContent) -> list[FileChannel]:
        raise InputError(content.path, f"{what}", "a history of samples", cure)

    return refuse


def channel_blocks(
    content: FileContent,
    read_block: Callable[[int, int], tuple[list[FileChannel], int]],
    end: str = "",
    end_required: bool = False,
) -> list[FileChannel]:
    """Read blocks of channels up to the end of a file.

    `read_block` takes the first line of a block and its number from 1; it returns the channels and the line behind the block.
    A line with the pattern `end` may end a block, or must.
    """
    channels: list[FileChannel] = []
    index = number = 0
    while index < len(content.lines) and content.line(index).strip():
        number += 1
        more, index = read_block(index, number)
        channels.extend(more)
        if end_required:
            index = content.require("end of a channel, '/&'", end, index, index + 1)[0] + 1
        elif end and (line := content.find(end, index, index + 1)) is not None:
            index = line[0] + 1
    content.refuse_rest(index)
    return channels


def check_count(where: str, declared: str, count: int, values: int) -> None:
    """Refuse a file whose number of values differs from its header."""
    if count != values:
        raise InputError(
            where,
            f"the header gives {declared}, but {values} values follow",
            "the number of values in the header",
            "Download the file again, since it is incomplete or damaged.",
        )


def check_step(where: str, step: float) -> float:
    """Return a time step [s], which must be a positive number."""
    if not 0.0 < step < np.inf:
        raise InputError(
            where, f"the header gives a time step of {step:g} s", "a positive time step", "Repair the header."
        )
    return step


def check_same(where: str, what: str, first: float, second: float, tolerance: float) -> None:
    """Refuse a header that gives one quantity twice, with different values."""
    if not abs(first - second) <= tolerance:
        raise InputError(
            where,
            f"the header gives two values of the {what}, {first:.6g} and {second:.6g}",
            "one value",
            "Download the file again, or repair its header.",
        )


def check_peak(channel: FileChannel, declared: float, digit: float) -> None:
    """Refuse values whose peak differs from the peak in the header, which is rounded to multiples of `digit`."""
    peak = float(np.abs(channel.values).max())
    if abs(peak - abs(declared)) > PEAK_TOLERANCE * peak + 1.5 * digit:
        raise InputError(
            channel.where,
            f"the largest value of {channel.name} is {peak:.6g} {channel.unit}, but the header gives {abs(declared):.6g}",
            "the peak of the header",
            "Download the file again, since values or header are damaged.",
        )


def last_digit(printed: str) -> float:
    """Return the unit of the last printed digit: 0.01 for ``"-3.25"``, 1e-7 for ``"5.0693293E+00"``."""
    mantissa, _, exponent = printed.strip().lower().replace("d", "e").partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(10.0 ** (int(exponent or 0) - decimals))
