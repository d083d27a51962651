"""DEEPSOIL motions: a line with count and time step, then pairs of time and acceleration."""

from __future__ import annotations

import re

from structid.data_files.base import FileChannel, FileFormat, check_count, check_same, check_step
from structid.data_files.file_content import FileContent, number, table
from structid.data_files.time_axis import constant_step

_COUNT_AND_STEP = re.compile(r"^\s*(\d+)[\s,]+(\d*\.\d+(?:[eE][-+]?\d+)?)\s*$")


def recognises(content: FileContent) -> bool:
    """Whether the first line is a count and a step, and the count is that of the lines that follow."""
    match = _COUNT_AND_STEP.match(content.line(0))
    if match is None or len(content.line(1).split()) != 2:
        return False
    rows = sum(bool(line.strip()) for line in content.lines[1:])
    return abs(int(match.group(1)) - rows) <= 0.5 * rows and int(match.group(1)) > 2


def read(content: FileContent) -> list[FileChannel]:
    """Read the one channel. The file has no unit; DEEPSOIL itself uses g."""
    match = _COUNT_AND_STEP.match(content.line(0))
    assert match is not None
    rows = table(content, 1, 2)
    check_count(content.at(0), f"{match.group(1)} points", int(match.group(1)), len(rows))
    step = check_step(content.at(0), number(match.group(2), content.at(0)))
    printed = constant_step(rows[:, 0], lambda n: content.at(1 + n))
    check_same(content.at(0), "time step", step, printed, 1e-3 * step)
    return [
        FileChannel(
            "acceleration",
            rows[:, 1],
            "",
            dt=step,
            start=float(rows[0, 0]),
            where=content.at(1),
            notes=("DEEPSOIL's own files are in g",),
        )
    ]


FORMAT = FileFormat("DEEPSOIL", recognises, read)
