"""eqsig's text: a label, a line with count and time step, then one value per line; the unit is not in the file."""

from __future__ import annotations

import re

from structid.data_files.base import FileChannel, FileFormat, check_count, check_step
from structid.data_files.file_content import FileContent, number, numbers

_COUNT_AND_STEP = re.compile(r"^\s*(\d+)\s+(\d*\.\d+(?:[eE][-+]?\d+)?)\s*$")


def recognises(content: FileContent) -> bool:
    """Whether the second line is a count and a step, and each of the next lines one number."""
    match = _COUNT_AND_STEP.match(content.line(1))
    following = [content.line(index).split() for index in (2, 3, 4)]
    label = content.line(0).strip()
    return match is not None and bool(re.search("[A-Za-z]", label)) and all(len(words) <= 1 for words in following)


def read(content: FileContent) -> list[FileChannel]:
    """Read the one channel."""
    match = _COUNT_AND_STEP.match(content.line(1))
    assert match is not None
    values = numbers(content, 2)
    check_count(content.at(1), f"{match.group(1)} values", int(match.group(1)), values.size)
    step = check_step(content.at(1), number(match.group(2), content.at(1)))
    return [FileChannel(content.line(0).strip(), values, "", dt=step, where=content.at(2))]


FORMAT = FileFormat("eqsig text", recognises, read)
