"""USC (Los Angeles, 1990s) and Caltech's volume 1: digitised films, pairs of times and accelerations in G/10."""

from __future__ import annotations

import re

from structid.data_files.agencies.volume1 import INTEGER_LINES, REAL_LINES, channel_of_pairs
from structid.data_files.base import FileChannel, FileFormat, unread
from structid.data_files.file_content import FileContent

_TEXT_LINES = 13
_VOLUME_1 = re.compile(r"uncorrected accelerogram data of volume i\b", re.IGNORECASE)
_OTHER_VOLUME = re.compile(r"corrected accelerogram.*file\s+\d+\s+correspond|volume ii+\b", re.IGNORECASE)


def recognises(content: FileContent) -> bool:
    """Whether the first line names uncorrected data of volume I."""
    return _VOLUME_1.search(content.line(0)) is not None


def read(content: FileContent) -> list[FileChannel]:
    """Read the one channel of the file."""
    _, component = content.require("component, 'COMP N90E'", r"^\s*comp\s+(\S.*?)(?:\s{2,}|$)", 0, _TEXT_LINES)
    _, points = content.require("number of points", r"no\. of points\s*=\s*(\d+)", 0, _TEXT_LINES)
    content.require("units, 'SEC AND G/10'", r"sec and g/10", 0, _TEXT_LINES)
    start = _TEXT_LINES + INTEGER_LINES + REAL_LINES
    channel, after = channel_of_pairs(content, start, int(points.group(1)), component.group(1), 1, indent=1)
    content.refuse_rest(after)
    return [channel]


def is_other_volume(content: FileContent) -> bool:
    """Whether the first line names corrected data or spectra of volume II or III."""
    return _OTHER_VOLUME.search(content.line(0)) is not None


FORMAT = FileFormat("USC or Caltech volume I", recognises, read)
OTHER_VOLUMES = FileFormat(
    "USC or Caltech volume II or III",
    is_other_volume,
    unread(
        "the values are corrected or spectral, and structid reads volume I only",
        "Use the file of volume I, or convert it to text.",
    ),
)
