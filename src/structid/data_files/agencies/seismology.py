"""SAC and miniSEED, read by ObsPy (an extra). Their values are counts, or in a unit that the file does not state."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, check_step, optional_library
from structid.data_files.file_content import FileContent
from structid.data_files.time_axis import ROUNDED_TIME

_SAC_VERSION_AT, _SAC_VERSIONS = 304, (6, 7)
"""Byte at which a SAC header has its version, and the versions."""


def is_sac(content: FileContent) -> bool:
    """Whether the binary header has the version of a SAC file, in either byte order."""
    if len(content.raw) < 632:
        return False
    version = content.raw[_SAC_VERSION_AT : _SAC_VERSION_AT + 4]
    return any(struct.unpack(order + "i", version)[0] in _SAC_VERSIONS for order in "<>")


def is_miniseed(content: FileContent) -> bool:
    """Whether the file begins with a record of miniSEED 2 or 3."""
    head = content.raw[:8]
    second = (
        len(head) == 8 and head[:6].decode("latin-1").strip().isdigit() and head[6:7] in b"DRQM" and head[7:8] in b" \0"
    )
    return second or head[:3] == b"MS\x03"


def _obspy_reader(name: str) -> FileFormat:
    recognises = {"SAC": is_sac, "MSEED": is_miniseed}[name]

    def read(content: FileContent) -> list[FileChannel]:
        obspy = optional_library(content, "obspy", f"a {name} file", "records")
        try:
            stream = obspy.read(io.BytesIO(content.raw), format=name)
        except Exception as cause:
            raise InputError(
                content.path, f"ObsPy cannot read it: {cause}", f"a {name} file", "Download it again."
            ) from cause
        pieces: dict[str, list[Any]] = {}
        for trace in stream:
            pieces.setdefault(trace.id, []).append(trace)
        return [_channel(content, traces, n) for n, traces in enumerate(pieces.values(), start=1)]

    return FileFormat({"SAC": "SAC", "MSEED": "miniSEED"}[name], recognises, read)


def _channel(content: FileContent, traces: list[Any], number: int) -> FileChannel:
    """Join the pieces of a channel; the samples between them are missing, NaN."""
    traces = sorted(traces, key=lambda trace: trace.stats.starttime)
    first = traces[0].stats
    step = check_step(content.path, float(first.delta))
    values = np.empty(0)
    for trace in traces:
        begin = float(trace.stats.starttime - first.starttime) / step
        gap = round(begin) - len(values)
        if abs(begin - round(begin)) > ROUNDED_TIME or gap < 0 or float(trace.stats.delta) != step:
            raise InputError(
                content.path,
                f"pieces of the channel {trace.id} that overlap, or are not at the same step",
                "pieces at one time step, one after another",
                "Merge the pieces with ObsPy, and save the file again.",
            )
        values = np.concatenate([values, np.full(gap, np.nan), trace.data.astype(float)])
    clock = str(first.starttime)
    return FileChannel(first.channel or traces[0].id, values, "", number, step, clock=clock, where=content.path)


SAC, MINISEED = _obspy_reader("SAC"), _obspy_reader("MSEED")
