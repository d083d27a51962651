"""RENADIC (University of Chile): uncorrected accelerograms, pairs of printed times and accelerations in G/10."""

from __future__ import annotations

from structid.data_files.agencies.volume1 import INTEGER_LINES, REAL_LINES, channel_of_pairs
from structid.data_files.base import FileChannel, FileFormat
from structid.data_files.file_content import FileContent

_TEXT_LINES = 13


def recognises(content: FileContent) -> bool:
    """Whether the header names RENADIC."""
    return "UNCORRECTED ACCELEROGRAM" in content.line(0).upper() and "RENADIC" in content.head.upper()


def read(content: FileContent) -> list[FileChannel]:
    """Read all channels; a line that begins with /& ends each."""
    channels: list[FileChannel] = []
    index = 0
    while index < len(content.lines) and content.line(index).strip():
        stop = index + _TEXT_LINES
        content.require("first line of a channel", r"^\s*uncorrected accelerogram", index, index + 1)
        _, name = content.require("channel, 'CHAN 1: NS'", r"^\s*chan\s*(\d+)\s*:\s*(.*?)\s*(?:\(|$)", index, stop)
        _, points = content.require("number of points", r"no\. of points\s*=\s*(\d+)", index, stop)
        content.require("units, 'SEC AND G/10'", r"sec and g/10", index, stop)
        start = stop + INTEGER_LINES + REAL_LINES
        channel, after = channel_of_pairs(content, start, int(points.group(1)), name.group(2), int(name.group(1)))
        channels.append(channel)
        end, _ = content.require("end of a channel, '/&'", r"^\s*/&", after, after + 1)
        index = end + 1
    content.refuse_rest(index)
    return channels


FORMAT = FileFormat("RENADIC", recognises, read)
