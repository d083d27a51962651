"""A signal from a table: the column of the values, the column of the times, the unit, the time step."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.units import factor, factor_of, same_dimension
from structid.data_files.tables.column_table import ColumnTable, is_wrapped
from structid.data_files.tables.titles import time_factor
from structid.data_files.time_axis import constant_step, step_with_gaps
from structid.data_files.unit_spellings import check_unit, spelt_unit

REPAIR_OR_LEAVE_OUT = "structid does not fill gaps. Repair a record; for a measurement, set missing = 'leave_out'."
"""Remedy for missing values."""

_MILLISECONDS = re.compile(r"(?<![A-Za-z])(?:ms|msec)(?![A-Za-z])|milli", re.IGNORECASE)


class Columns(NamedTuple):
    """Columns of a file, with a constant time step."""

    start: float  # time of the first line [s]; 0 for a file without times
    dt: float  # time step [s]
    values: Float[np.ndarray, "time column"]  # requested columns in SI


def columns_of_table(
    table: ColumnTable,
    unit: str | None,
    dt: float | None = None,
    column: int | str | None = None,
    si_unit: str | None = None,
    others: Sequence[int] = (),
    time_column: int | str | None = None,
    gaps: bool = False,
) -> Columns:
    """Return columns of a table in SI, with the time step of its time column or a given one.

    With `gaps`, empty cells and missing lines are missing values, NaN; otherwise they are refused.
    """
    time = _time_column(table, dt, time_column)
    if table.stamp and dt is None:
        raise InputError(
            table.at(0),
            f"a date or a time of day, '{table.stamp}', in the first column",
            "times in seconds, or a time step",
            "Give the step and the column of the values: dt=0.01, column=1.",
        )
    first = _index(table, column, "column") if column is not None else _only_column(table, time, dt, len(others))
    columns = [first, *others]
    for index in columns:
        _check_index(table, index)
    told = any(table.units) or bool(table.time_columns())
    if not told and is_wrapped(table.values):
        _refuse_wrapped(table)
    if time is not None and time in columns:
        raise InputError(table.at(0), f"column {time} is the time", "a column of values", "Give another column.")
    if gaps and time is not None and not table.stamp:
        _check_one_step(table, dt)
        start, step, values = _with_gaps(table, time, columns, table.step if dt is None else dt)
        return Columns(start, step, values * _factor(table, columns, unit, si_unit))
    start, step = _start_and_step(table, time, dt)
    values = table.values[:, columns]
    if not gaps:
        _refuse_gaps(table, values, columns)
    return Columns(start, step, values * _factor(table, columns, unit, si_unit))


def time_axis(
    table: ColumnTable,
) -> tuple[int | None, float | None, Float[np.ndarray, " row"] | None]:
    """Return the column of the times, the constant step [s], or the times [s] if the step varies.

    A table without times has samples at 0, 1, 2 …
    """
    named = table.time_columns()
    column = named[0] if named else (0 if table.values.shape[1] > 1 and _is_regular(table.values[:, 0]) else None)
    if column is None or table.stamp or np.isnan(table.values[:, column]).any():
        return column, table.step, None if table.step is not None else np.arange(len(table.values), dtype=float)
    times = table.values[:, column] * _seconds(table, column)
    return (column, constant_step(times, table.at), None) if _is_regular(times) else (column, None, times)


def first_time(table: ColumnTable, column: int | None) -> float:
    """Return the time of the first row [s]; 0 for a table without times."""
    return 0.0 if column is None or table.stamp else float(table.values[0, column] * _seconds(table, column))


def values_of_column(
    table: ColumnTable, column: int | str, unit: str | None, si_unit: str, gaps: bool = False
) -> Float[np.ndarray, " row"]:
    """Return one column in SI, without regard to times; with `gaps`, empty cells are NaN, otherwise they are refused."""
    index = _index(table, column, "column")
    if index in table.time_columns():
        raise InputError(
            table.at(0),
            f"column {index}, '{table.titles[index]}', is the time",
            "a column of values",
            "Name another column.",
        )
    values = table.values[:, [index]]
    if not gaps:
        _refuse_gaps(table, values, [index])
    return values[:, 0] * _factor(table, [index], unit, si_unit)


def _index(table: ColumnTable, column: int | str, argument: str) -> int:
    """Return the index of a column that is given by number or by title."""
    if isinstance(column, int):
        _check_index(table, column)
        return column
    plain = [title.lower() for title in table.titles]
    bare = [title.partition("[")[0].partition("(")[0].strip().lower() for title in table.titles]
    matches = [n for n, titles in enumerate(zip(plain, bare, strict=True)) if column.strip().lower() in titles]
    if len(matches) != 1:
        named = ", ".join(f"'{title}'" for title in table.titles if title) or "no titles; give a number"
        raise InputError(
            table.path,
            f"{argument}='{column}' is the title of {len(matches)} columns",
            named,
            "Give a title, or a number from 0.",
        )
    return matches[0]


def _check_index(table: ColumnTable, index: int) -> None:
    columns = table.values.shape[1]
    if not 0 <= index < columns:
        raise InputError(
            table.path,
            f"column {index} is missing, since the file has {columns} columns",
            f"a column from 0 to {columns - 1}",
            "Give an existing column. For a file with a single column, give dt.",
        )


def _time_column(table: ColumnTable, dt: float | None, given: int | str | None) -> int | None:
    """Return the column of the times: given, named by its title, or the first one if the file has no titles."""
    if given is not None:
        return _index(table, given, "time_column")
    named = table.time_columns()
    if len(named) > 1:
        names = ", ".join(f"'{table.titles[n] or n}'" for n in named)
        raise InputError(table.path, f"{len(named)} columns of times: {names}", "one", "Name it: time_column=0.")
    if named:
        _check_named_time(table, named[0])
        return named[0]
    if dt is not None or table.step is not None:
        return None
    if table.values.shape[1] == 1:
        return 0
    if table.title_line == 0:
        _check_first_is_time(table)
    return 0


def _check_named_time(table: ColumnTable, column: int) -> None:
    """Refuse a column that a title calls the time if it does not increase, but the first one does by a constant step."""
    if column and not (np.diff(table.values[:, column]) > 0.0).all() and _is_regular(table.values[:, 0]):
        raise InputError(
            f"{table.path}, line {table.title_line}",
            f"'{table.titles[column]}' is above column {column}, which does not increase, but column 0 does",
            "one title above each column",
            "Name the column of the times: time_column=0.",
        )


def _check_first_is_time(table: ColumnTable) -> None:
    """Refuse a table without titles whose first column is no time, but another one is."""
    if np.isnan(table.values[:, 0]).any() or (np.diff(table.values[:, 0]) > 0.0).all():
        return  # an empty cell or an irregular time is named by its line
    regular = [n for n in range(table.values.shape[1]) if _is_regular(table.values[:, n])]
    if regular and 0 not in regular:
        raise InputError(
            table.at(0),
            f"the first column does not increase by a constant step, but column {regular[0]} does",
            "the column of the times",
            f"Give it: time_column={regular[0]}.",
        )


def _is_regular(values: Float[np.ndarray, " row"]) -> bool:
    if np.isnan(values).any():
        return False
    try:
        constant_step(values, str)
    except InputError:
        return False
    return True


def _only_column(table: ColumnTable, time: int | None, dt: float | None, others: int) -> int:
    """Return the column of the values, if it is unambiguous."""
    columns, where = table.values.shape[1], table.at(0)
    wrapped = "If the record continues from line to line, write one value per line and give dt."
    if time is None:
        if columns > 1 + others:
            allowed = (
                "one value per line"
                if is_wrapped(table.values)
                else f"column=0 to {columns - 1}, or one value per line"
            )
            cure = f"{wrapped} If there is a time column, leave dt out."
            raise InputError(where, f"{columns} values per line and a time step, but no column is named", allowed, cure)
        return 0
    if columns == 1:
        raise InputError(
            table.path,
            "one column and no time step",
            "a column of times, or a time step",
            "Give the time step: dt=0.01.",
        )
    if columns > 2 + others:
        free = [n for n in range(columns) if n != time]
        allowed = f"column={free[0]} to {free[-1]}, since column {time} is the time"
        titles = ", ".join(f"{n} '{table.titles[n]}'" for n in free if table.titles[n])
        if is_wrapped(table.values) and not any(table.units):
            allowed = "one value per line"
        raise InputError(
            where,
            f"{columns} values per line, but no column is named",
            allowed,
            f"The columns are {titles}." if titles else wrapped,
        )
    return next(n for n in range(columns) if n != time)


def _refuse_wrapped(table: ColumnTable) -> None:
    columns = table.values.shape[1]
    raise InputError(
        table.at(0),
        f"{columns} values per line that continue from line to line, so the columns are not channels",
        "one value per line, or a file with the header of its network",
        "Write one value per line and give dt. If the columns are channels, write a line of titles above them.",
    )


def _check_one_step(table: ColumnTable, dt: float | None) -> None:
    """Refuse a step that contradicts the first line of the file."""
    if table.step is not None and dt is not None and abs(table.step / dt - 1.0) > 1e-3:
        raise InputError(
            table.path,
            f"the first line gives a time step of {table.step:g} s, but dt={dt:g} is given",
            "one time step",
            "Leave dt out.",
        )


def _start_and_step(table: ColumnTable, time: int | None, dt: float | None) -> tuple[float, float]:
    """Return the first time and the time step [s]; a given step must agree with the file's."""
    _check_one_step(table, dt)
    if time is None or table.stamp:
        step = dt if dt is not None else table.step
        assert step is not None
        _check_no_header_value(table, step)
        return 0.0, step
    if table.step is not None and dt is None:
        dt = table.step
    if dt is not None:
        return _given_step(table, time, dt)
    times = table.values[:, time]
    if np.isnan(times).any():
        row = int(np.argmax(np.isnan(times)))
        raise InputError(
            table.at(row), "an empty cell in the column of the times", "a time in every line", "Fill the cell."
        )
    seconds = _seconds(table, time)
    step = constant_step(times * seconds, table.at)
    return float(times[0] * seconds), step


def _with_gaps(
    table: ColumnTable, time: int, columns: Sequence[int], dt: float | None
) -> tuple[float, float, np.ndarray]:
    """Return the first time, the step, and the values with NaN for each missing line or cell."""
    rows = np.flatnonzero(np.isfinite(table.values[:, time]))
    times = table.values[rows, time] * _seconds(table, time)
    step, samples = step_with_gaps(times, lambda row: table.at(int(rows[row]) if len(rows) else 0), dt)
    values = np.full((samples[-1] + 1, len(columns)), np.nan)
    values[samples] = np.where(np.isfinite(cells := table.values[rows][:, columns]), cells, np.nan)
    return float(times[0]), step, values


def _check_no_header_value(table: ColumnTable, step: float) -> None:
    """Refuse a single column that begins with the time step, the rate or the number of the values."""
    if table.values.shape[1] > 1:
        return
    first, count = float(table.values[0, 0]), len(table.values)
    if first in (step, count - 2) or (first >= 10.0 and abs(first * step - 1.0) < 1e-9):
        raise InputError(
            table.at(0),
            f"the first value, {first:g}, is the time step, the rate, or the number of the values",
            "values only",
            "Remove the line, or put the number and the step into one line: '4000 0.01'.",
        )


def _given_step(table: ColumnTable, time: int, dt: float) -> tuple[float, float]:
    """Return the first time and the given step, which must agree with a regular time column."""
    times = table.values[:, time] * _seconds(table, time)
    printed = constant_step(times, table.at, rounding=0.5 * dt)
    if abs(printed / dt - 1.0) > 1e-3:
        raise InputError(
            table.at(1),
            f"the column of the times increases by {printed:.6g} s, but dt={dt:g} is given",
            "one time step",
            "Leave dt out. If the times are not in seconds, write their unit into the title, as in 'time [ms]'.",
        )
    return float(times[0]), dt


def _seconds(table: ColumnTable, time: int) -> float:
    """Return the factor that converts the times to seconds, by the unit in the title."""
    where = f"{table.path}, line {table.title_line}" if table.title_line else table.path
    seconds = time_factor(where, table.titles[time], table.units[time])
    if not table.titles[time] and not table.units[time] and _MILLISECONDS.search(table.header):
        raise InputError(
            table.at(0),
            "the lines above the numbers mention milliseconds, but are no titles of the columns",
            "a line with one title for each column",
            "Write the titles into one line, as in 'time [ms];force [kN]'.",
        )
    return seconds


def _refuse_gaps(table: ColumnTable, values: Float[np.ndarray, "row column"], columns: Sequence[int]) -> None:
    """Refuse missing values, with the first line that has one."""
    missing = ~np.isfinite(values)
    if not missing.any():
        return
    row, which = (int(n) for n in np.argwhere(missing)[0])
    raise InputError(
        table.at(row),
        f"an empty cell or no finite number in column {columns[which]}; {np.count_nonzero(missing)} values are missing",
        "a number in every cell",
        REPAIR_OR_LEAVE_OUT,
    )


def _factor(table: ColumnTable, columns: Sequence[int], unit: str | None, si_unit: str | None) -> float:
    """Return the factor of the values to SI from the given unit, or from the titles; both must agree."""
    in_file = [(n, spelt) for n in columns if (spelt := table.units[n]) and spelt_unit(spelt) is not None]
    where = f"{table.path}, line {table.title_line}"
    if unit is None:
        if not in_file:
            raise InputError(
                table.path,
                "the unit of a text file is missing",
                "unit='g', 'm/s^2', 'cm/s^2', …",
                "Give the unit of the values: GroundMotion.read(path, unit='g').",
            )
        unit = spelt_unit(in_file[0][1])
        assert unit is not None
    given = spelt_unit(unit) or unit
    for n, spelt in in_file:
        own = spelt_unit(spelt)
        assert own is not None
        if not (same_dimension(own, given) and abs(factor(own) / factor(given) - 1.0) < 1e-3):
            check_unit(where, f"{spelt}' of the column '{table.titles[n]}", own, unit)
    return factor(given) if si_unit is None else factor_of(given, si_unit, f"{table.path}: unit")
