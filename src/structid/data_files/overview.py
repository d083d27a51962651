"""An overview of data files: format, channels, and what each channel shows."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from structid.core.notebook import ShownAsText
from structid.core.validation import check_arguments
from structid.data_files.base import FileChannel
from structid.data_files.inspection import ChannelFacts, compare, comparisons, facts_of
from structid.data_files.read_file import read_file
from structid.data_files.tables.column_table import ColumnTable
from structid.data_files.tables.pick_column import first_time, time_axis
from structid.data_files.unit_spellings import quantity_of, spelt_unit

SWAPPED = 0.9
"""Correlation from which channels of two files with different names are the same motion."""


@dataclass(frozen=True, eq=False, repr=False)
class FileOverview(ShownAsText):
    r"""What a data file holds.

    Parameters
    ----------
    path : str
        The file.
    format : str
        Name of the format.
    channels : tuple of ChannelFacts
        The channels, each with its unit, rate, length and peak, and what is remarkable in it.
    has_columns : bool
        Whether the channels are columns of a table, whose numbers count from 0.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import structid as si
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "table.csv"
    >>> _ = file.write_text("time [s],floor [g]\n" + "".join(f"{0.01 * n:.2f},{n % 7}\n" for n in range(50)))
    >>> si.look(file).channels[0].dt
    0.01
    """

    path: str
    format: str
    channels: tuple[ChannelFacts, ...]
    has_columns: bool = False

    def __str__(self) -> str:
        lines = [
            f"{Path(self.path).name}: {self.format}, {len(self.channels)} channel{'s' if len(self.channels) != 1 else ''}"
        ]
        for facts in self.channels:
            lines.append(f"  {described(facts)}")
            lines.extend(f"      {finding.kind}: {finding.sentence}" for finding in facts.findings)
            lines.extend(f"      note: {note}" for note in facts.channel.notes)
        return "\n".join(lines)


@check_arguments
def look(path: str | os.PathLike[str]) -> FileOverview:
    r"""Show what a data file holds, without a model.

    Parameters
    ----------
    path : path-like
        A file of any format that `GroundMotion.read` reads.

    Returns
    -------
    FileOverview
        Format and channels; ``print`` it.

    Raises
    ------
    InputError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import structid as si
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "table.csv"
    >>> _ = file.write_text("time [s],floor [g]\n" + "".join(f"{0.01 * n:.2f},{n % 7}\n" for n in range(50)))
    >>> print(si.look(file))
    table.csv: text columns, 1 channel
      1 'floor [g]': acceleration in g, 100 Hz, 50 samples, 0 to 0.49 s, peak 6 at 0.06 s
    """
    file = read_file(path)
    channels = file.channels if file.table is None else channels_of_table(file.table)
    return FileOverview(
        str(path), file.format, tuple(facts_of(channel) for channel in channels), file.table is not None
    )


def described(facts: ChannelFacts) -> str:
    """Return one line about a channel: number, name, quantity, unit, rate, length, peak."""
    channel = facts.channel
    rate = f"{1.0 / facts.dt:.6g} Hz" if facts.dt else "no time step" if channel.counted else "uneven steps"
    unit = channel.unit.lstrip("?") or "no unit"
    quantity = f"{channel.quantity} in {unit}" if channel.quantity else unit
    first = f"{channel.number} '{channel.name}': {quantity}, {rate}, {len(channel.values)} samples"
    if channel.counted:
        return f"{first}, peak {facts.peak:.5g} at sample {facts.peak_time:.0f}"
    clock = f", clock {channel.clock}" if channel.clock else ""
    times = f"{channel.start:.6g} to {channel.start + facts.length:.6g} s"
    return f"{first}, {times}, peak {facts.peak:.5g} at {facts.peak_time:.6g} s{clock}"


def channels_of_table(table: ColumnTable) -> list[FileChannel]:
    """Return the columns of a table as channels; their numbers are those of the columns, from 0."""
    time, step, times = time_axis(table)
    others = table.time_columns()  # a table may have several columns of times; none of them is a measurement
    channels = []
    for column in range(table.values.shape[1]):
        if column == time or column in others:
            continue
        spelt = table.units[column]
        unit = (spelt_unit(spelt) or "") if spelt else ""
        channels.append(
            FileChannel(
                name=table.titles[column] or f"column {column}",
                values=table.values[:, column],
                unit=unit,
                number=column,
                dt=step,
                times=times,
                start=first_time(table, time),
                counted=times is not None and time is None,
                quantity=quantity_of(unit),
                where=table.at(0),
            )
        )
    return channels


def relations(files: Sequence[FileOverview]) -> list[str]:
    """Say how the channels of some files are related: reversed, late, repeated or swapped."""
    labelled = [
        (
            f"{Path(file.path).name} '{facts.channel.name}'" if len(files) > 1 else f"'{facts.channel.name}'",
            facts.channel,
        )
        for file in files
        for facts in file.channels
    ]
    return [*comparisons(labelled), *_swapped(files)]


def _swapped(files: Sequence[FileOverview]) -> list[str]:
    """Say which channels of two files seem to have exchanged their names."""
    sentences = []
    for n, first in enumerate(files):
        for second in files[n + 1 :]:
            a, b = ({facts.channel.name: facts.channel for facts in file.channels} for file in (first, second))
            shared = [name for name in a if name in b]
            for k, one in enumerate(shared):
                for two in shared[k + 1 :]:
                    if _alike(a[one], b[two]) and _alike(a[two], b[one]) and not _alike(a[one], b[one]):
                        sentences.append(
                            f"'{one}' of {Path(first.path).name} is '{two}' of {Path(second.path).name}, and the reverse: are the "
                            "channels swapped?"
                        )
    return sentences


def _alike(first: FileChannel, second: FileChannel) -> bool:
    found = compare(first, second)
    return found is not None and abs(found.correlation) > SWAPPED
