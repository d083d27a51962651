"""Read a data file of any known format, and take one signal from it."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from structid.core.errors import InputError
from structid.core.units import factor, factor_of, same_dimension
from structid.data_files import format_list
from structid.data_files.base import DataFile, FileChannel, FileFormat
from structid.data_files.file_content import FileContent
from structid.data_files.tables.column_table import ColumnTable
from structid.data_files.tables.pick_column import REPAIR_OR_LEAVE_OUT, Columns, columns_of_table
from structid.data_files.tables.text_table import table_of_text
from structid.data_files.unit_spellings import QUANTITIES, check_unit, spelt_unit

FEWEST_SAMPLES = 2
"""Smallest number of samples of a history."""

TEXT_COLUMNS = "text columns"


def recognised_format(content: FileContent) -> FileFormat | None:
    """Return the format of a file; None for text columns."""
    for file_format in format_list.BINARY_FORMATS:
        if file_format.recognises(content):
            return file_format
    if content.is_binary:
        raise InputError(
            content.path,
            "a binary file of a format that structid does not know",
            "text, or one of the formats on the page 'From your files to a study'",
            "Export the file from its program as text with a title line.",
        )
    return next((file_format for file_format in format_list.TEXT_FORMATS if file_format.recognises(content)), None)


def read_file(path: str | os.PathLike[str]) -> DataFile:
    """Read all that a file holds: channels, or a table of columns."""
    content = FileContent(path)
    file_format = recognised_format(content)
    if file_format is None:
        return DataFile(content.path, TEXT_COLUMNS, table=table_of_text(content))
    try:
        held = file_format.read(content)
        if isinstance(held, ColumnTable) and len(held.values) < FEWEST_SAMPLES:
            raise InputError(content.path, f"{len(held.values)} samples", "two or more samples", "Save the file again.")
    except InputError as fault:
        raise InputError(
            fault.where, f"in this {file_format.name} file, {fault.came}", fault.allowed, fault.cure
        ) from None
    if isinstance(held, ColumnTable):
        return DataFile(content.path, file_format.name, table=held)
    return DataFile(content.path, file_format.name, held)


def read_table(path: str | os.PathLike[str]) -> ColumnTable:
    """Read a file that holds a table of columns."""
    file = read_file(path)
    if file.table is None:
        raise InputError(
            file.path,
            f"a file of the format {file.format}, which has no columns",
            "a table of columns",
            "Export it as text.",
        )
    return file.table


def read_signal(
    path: str | os.PathLike[str],
    unit: str | None = None,
    dt: float | None = None,
    column: int | str | None = None,
    si_unit: str | None = None,
    others: Sequence[int] = (),
    time_column: int | str | None = None,
    component: str | int | None = None,
    gaps: bool = False,
) -> Columns:
    """Return one signal of a file in SI; `column` names a column of a table, `component` a channel of another format.

    With `gaps`, values may be missing; they are NaN. `si_unit` is the SI unit of the wanted quantity, or None for any. Unit and
    step that are given must agree with the file's.
    """
    _check_choices(dt, unit, column=column, time_column=time_column, component=component)
    file = read_file(path)
    if file.table is not None:
        if component is not None:
            column = component if column is None else column
        return columns_of_table(file.table, unit, dt, column, si_unit, others, time_column, gaps)
    for name, given in (("column", column), ("time_column", time_column), ("sd_column", others or None)):
        if given is not None:
            raise InputError(
                file.path,
                f"{name}={given!r} is given, but this is a file of the format {file.format}, which has no columns",
                "a component, which is the name or the number of a channel",
                f"Give it: component='{file.channels[0].name}'.",
            )
    channel = pick_channel(file, si_unit, component)
    step, values = _at_constant_step(channel, dt)
    if not gaps:
        _refuse_missing(channel, values)
    return Columns(channel.start, step, (values * _factor(file, channel, unit, si_unit))[:, None])


def _refuse_missing(channel: FileChannel, values: np.ndarray) -> None:
    missing = np.count_nonzero(~np.isfinite(values))
    if missing:
        raise InputError(
            channel.where,
            f"{missing} of {values.size} values of the channel '{channel.name}' are missing",
            "a value for every sample",
            REPAIR_OR_LEAVE_OUT,
        )


def _check_choices(dt: object, unit: object, **choices: object) -> None:
    """Refuse a step, a unit or a choice of the wrong type."""
    if unit is not None and not isinstance(unit, str):
        raise InputError("unit", f"{unit!r}", "a string such as 'kN'", "Write the unit in quotes.")
    if dt is not None and not (isinstance(dt, (int, float)) and 0.0 < dt < np.inf):
        raise InputError("dt", f"{dt!r}", "a positive time step in seconds", "Give the step, such as dt=0.01.")
    for name, choice in choices.items():
        if choice is not None and (isinstance(choice, bool) or not isinstance(choice, (int, str, np.integer))):
            raise InputError(name, f"{choice!r}", "a number or a name", f"Give one, such as {name}=1.")


def _factor(file: DataFile, channel: FileChannel, unit: str | None, si_unit: str | None) -> float:
    """Return the factor of a channel to SI from its own unit or a given one; both must agree."""
    known = channel.has_unit
    if unit is not None:
        if known:
            check_unit(channel.where, channel.unit, channel.unit, unit)
        given = spelt_unit(unit) or unit
        return factor(given) if si_unit is None else factor_of(given, si_unit, f"{file.path}: unit")
    if not known and not channel.unit and channel.usual_unit:
        return factor(channel.usual_unit)
    if not known:
        stated = channel.unit.lstrip("?")
        hint = f" ({'; '.join(channel.notes)})" if channel.notes else ""
        raise InputError(
            channel.where,
            f"the file states the unit '{stated}', which is no unit of {channel.quantity or 'a signal'}{hint}"
            if stated
            else f"the {file.format} file does not state a unit{hint}",
            "the unit of the values, such as unit='g' or unit='cm/s^2'",
            "Give it as the argument unit.",
        )
    return factor(channel.unit)


def _at_constant_step(channel: FileChannel, dt: float | None) -> tuple[float, np.ndarray]:
    """Return step and values. Samples at uneven times are interpolated linearly, at a step that must be given."""
    if channel.dt is not None:
        if dt is not None and abs(dt / channel.dt - 1.0) > 1e-6:
            raise InputError(
                channel.where,
                f"the header gives a time step of {channel.dt:g} s, but dt={dt:g} is given",
                "one time step",
                "Leave dt out, or correct the header.",
            )
        return channel.dt, channel.values
    assert channel.times is not None
    if channel.counted:
        if dt is None:
            raise InputError(channel.where, "no time step in the file", "a time step", "Give it: dt=0.01.")
        return dt, channel.values
    steps = np.diff(channel.times)
    usual = float(np.median(steps))
    if dt is None:
        raise InputError(
            channel.where,
            f"the samples are not at a constant step: {steps.min():.3g} to {steps.max():.3g} s, usually {usual:.3g} s",
            "a time step for linear interpolation",
            f"Give it: dt={float(f'{usual:.1g}'):g} interpolates linearly between the samples.",
        )
    count = int(np.floor((channel.times[-1] - channel.times[0]) / dt * (1.0 + 1e-12))) + 1
    return dt, np.interp(channel.times[0] + dt * np.arange(count), channel.times, channel.values)


def pick_channel(file: DataFile, si_unit: str | None, component: str | int | None) -> FileChannel:
    """Return the channel with a quantity and a component; without a component, the only one."""
    channels = [channel for channel in file.channels if _is_of(channel, si_unit)]
    wanted = next((name for name, si in QUANTITIES.items() if si_unit == si), f"a quantity in {si_unit}")
    if not channels:
        held = ", ".join(sorted({channel.quantity or f"a channel in {channel.unit}" for channel in file.channels}))
        raise InputError(
            file.channels[0].where,
            f"the file has the format {file.format} and holds: {held}",
            f"an {wanted}" if wanted[0] in "aeiou" else wanted,
            f"Use the file with the {wanted} of this record.",
        )
    chosen = channels if component is None else [channel for channel in channels if _is(channel, component)]
    if len(chosen) == 1:
        return chosen[0]
    held = ", ".join(f"{channel.number} '{channel.name}'" for channel in channels)
    which = "no component is given" if component is None else f"component={component!r} is {len(chosen)} of them"
    raise InputError(
        file.path,
        f"the file has the format {file.format} and holds {len(channels)} channels, but {which}",
        f"one of {held}",
        f"Give a name or a number, such as component='{channels[0].name}' or component={channels[0].number}.",
    )


def _is_of(channel: FileChannel, si_unit: str | None) -> bool:
    """Whether a channel may hold the wanted quantity."""
    if si_unit is None:
        return True
    if channel.quantity:
        return same_dimension(QUANTITIES[channel.quantity], si_unit)
    return not channel.has_unit or same_dimension(channel.unit, si_unit)


def _is(channel: FileChannel, component: str | int) -> bool:
    """Whether a component names a channel by its number or its name."""
    if isinstance(component, int):
        return channel.number == component
    return "".join(component.split()).lower() == "".join(channel.name.split()).lower()
