"""Lines of a study file for data files, as `structid look` prints them and `structid new --from` writes them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from structid.core.errors import InputError
from structid.core.units import same_dimension
from structid.data_files.inspection import ChannelFacts
from structid.data_files.overview import FileOverview

CHANNELS = {
    "m/s^2": "absolute_acceleration",
    "m/s": "velocity",
    "m": "displacement",
    "N": "restoring_force",
}
"""Usual channel for a measured history, by the SI unit of its file."""


TIME_BASE = (
    '# time_shift = "0 s"   # time in this file at which the record begins, if their time bases or lengths differ'
)
"""Line for the time base of a measured response."""


def record_lines(overview: FileOverview) -> str:
    """Return a [record] table for the first acceleration in a file."""
    facts = _first_acceleration(overview)
    if facts is None:
        return f"# {Path(overview.path).name} holds no acceleration"
    lines = ["[record]", f"file = {_quoted(overview.path)}", *_choice(overview, facts), *_unit(facts), *_step(facts)]
    others = [f"'{other.channel.name}'" for other in _of_same_quantity(overview, facts) if other is not facts]
    if others:
        lines[1] += f"   # or {', '.join(others[:5])}"
    return "\n".join(lines)


def observation_lines(overview: FileOverview, most: int = 12) -> str:
    """Return an [[observation]] table for each channel of a file."""
    tables = []
    for facts in overview.channels[:most]:
        lines = ["[[observation]]", f"file = {_quoted(overview.path)}", *_choice(overview, facts)]
        lines.append(f'channels = ["{_channel(facts)}"]')
        tables.append("\n".join([*lines, *_unit(facts), *_step(facts), *_left_out(facts), TIME_BASE]))
    if len(overview.channels) > most:
        tables.append(f"# … and {len(overview.channels) - most} more channels")
    return "\n\n".join(tables)


def cyclic_lines(overview: FileOverview) -> str | None:
    """Return a [cyclic_test] table for the first displacement and the first force in a file; None if it lacks one of them."""
    found = [
        next((f for f in overview.channels if f.channel.has_unit and same_dimension(f.channel.unit, si)), None)
        for si in ("m", "N")
    ]
    if not overview.has_columns or None in found:
        return None
    lines = ["[cyclic_test]", f"file = {_quoted(overview.path)}"]
    for name, facts in zip(("displacement", "force"), found, strict=True):
        assert facts is not None
        lines += [f"{name}_column = {facts.channel.number}", f"{name}_unit = {_quoted(facts.channel.unit)}"]
    return "\n".join(lines)


def cyclic_study_from_files(text: str, overviews: Sequence[FileOverview]) -> str:
    """Replace the test of the packaged study of a cyclic test by that of one file."""
    if len(overviews) != 1:
        raise InputError(
            "--from", f"{len(overviews)} files", "one file, with displacement and force", "Merge the two columns."
        )
    lines = cyclic_lines(overviews[0])
    if lines is None:
        name = Path(overviews[0].path).name
        raise InputError(
            "--from",
            f"{name} holds no columns of a displacement and a force with units",
            "a table with both",
            "Leave --from out, and fill in the columns and units of [cyclic_test].",
        )
    return _replaced(text, "[cyclic_test]", lines)


def study_from_files(text: str, overviews: Sequence[FileOverview]) -> str:
    """Replace record and observation of the packaged study of a measurement by those of some files.

    The first file with an acceleration is the excitation; its first acceleration is used. The other files are measured.
    """
    record = next((overview for overview in overviews if _first_acceleration(overview) is not None), None)
    if record is None:
        raise InputError(
            "--from",
            "no file holds an acceleration",
            "the record of the excitation among the files",
            "For a cyclic test, add --like cyclic.",
        )
    measured = [overview for overview in overviews if overview is not record] or [record]
    lines = record_lines(record)
    text = _replaced(text, "[record]", lines)
    text = text.replace('file = "MY_RECORD.AT2"', lines.partition("\n")[2])  # in the records of predictions
    return _replaced(text, "[observation]", "\n\n".join(observation_lines(overview) for overview in measured))


def _replaced(text: str, title: str, lines: str) -> str:
    """Replace one table of a study file, up to the next table."""
    before, _, rest = text.partition(f"\n{title}")
    after = rest[rest.index("\n[") :]
    return f"{before}\n{lines}\n{after}"


def _first_acceleration(overview: FileOverview) -> ChannelFacts | None:
    """Return the first acceleration, or else the first channel without a unit."""
    known = [facts for facts in overview.channels if facts.channel.quantity == "acceleration"]
    unknown = [facts for facts in overview.channels if not facts.channel.quantity and not facts.channel.unit]
    return next(iter([*known, *unknown]), None)


def _of_same_quantity(overview: FileOverview, facts: ChannelFacts) -> list[ChannelFacts]:
    return [other for other in overview.channels if other.channel.quantity == facts.channel.quantity]


def _choice(overview: FileOverview, facts: ChannelFacts) -> list[str]:
    """Return the line that names a channel, if the file has several of its quantity."""
    if overview.has_columns:
        return [f"column = {facts.channel.number}"] if len(overview.channels) > 1 else []
    if len(_of_same_quantity(overview, facts)) < 2:
        return []
    return [f"component = {json.dumps(facts.channel.name, ensure_ascii=False)}"]


def _unit(facts: ChannelFacts) -> list[str]:
    """Return the line of the unit, if the file does not state it."""
    return [] if facts.channel.has_unit else ['unit = "UNIT"   # the file does not state it']


def _left_out(facts: ChannelFacts) -> list[str]:
    """Return lines that leave out missing values and stretches without a signal, as comments."""
    kinds = {finding.kind for finding in facts.findings}
    lines = ['# missing = "leave_out"   # leaves out empty cells and missing lines'] if "gap" in kinds else []
    if kinds & {"dead", "saturation", "spike"}:
        lines.append('# gaps = [["BEGIN s", "END s"]]   # leaves out stretches in which the sensor failed')
    return lines


def _step(facts: ChannelFacts) -> list[str]:
    """Return the line of the time step, if the file does not state it."""
    return [] if facts.dt is not None else ['dt = "STEP s"   # the samples are not at a constant step']


def _channel(facts: ChannelFacts) -> str:
    channel = facts.channel
    names = (name for si, name in CHANNELS.items() if channel.has_unit and same_dimension(channel.unit, si))
    return next(names, "CHANNEL")


def _quoted(path: str) -> str:
    return json.dumps(path, ensure_ascii=False)
