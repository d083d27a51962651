"""RENADIC (University of Chile): uncorrected accelerograms, pairs of printed times and accelerations in G/10."""

from __future__ import annotations

from functools import partial

from structid.data_files.agencies.volume1 import INTEGER_LINES, REAL_LINES, channel_of_pairs
from structid.data_files.base import FileChannel, FileFormat, channel_blocks
from structid.data_files.file_content import FileContent

_TEXT_LINES = 13


def recognises(content: FileContent) -> bool:
    """Whether the header names RENADIC."""
    return "UNCORRECTED ACCELEROGRAM" in content.line(0).upper() and "RENADIC" in content.head.upper()


def read(content: FileContent) -> list[FileChannel]:
    """Read all channels; a line that begins with /& ends each."""
    return channel_blocks(content, partial(_channel, content), r"^\s*/&", end_required=True)


def _channel(content: FileContent, start: int, number: int) -> tuple[list[FileChannel], int]:
    """Read one channel; its own number counts."""
    stop = start + _TEXT_LINES
    content.require("first line of a channel", r"^\s*uncorrected accelerogram", start, start + 1)
    _, name = content.require("channel, 'CHAN 1: NS'", r"^\s*chan\s*(\d+)\s*:\s*(.*?)\s*(?:\(|$)", start, stop)
    _, points = content.require("number of points", r"no\. of points\s*=\s*(\d+)", start, stop)
    content.require("units, 'SEC AND G/10'", r"sec and g/10", start, stop)
    first = stop + INTEGER_LINES + REAL_LINES
    channel, after = channel_of_pairs(content, first, int(points.group(1)), name.group(2), int(name.group(1)))
    return [channel], after


FORMAT = FileFormat("RENADIC", recognises, read)
