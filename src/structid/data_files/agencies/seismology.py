"""SAC and miniSEED, read by ObsPy (an extra). Their values are counts, or in a unit that the file does not state."""

from __future__ import annotations

import io
import struct

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, check_step, optional_library
from structid.data_files.file_content import FileContent

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
        channels = []
        for n, trace in enumerate(stream, start=1):
            if any(other is not trace and other.id == trace.id for other in stream):
                gap = "Merge the pieces with ObsPy, and decide how gaps are filled."
                raise InputError(
                    content.path, f"several pieces of the channel {trace.id}", "one piece without a gap", gap
                )
            step = check_step(content.path, float(trace.stats.delta))
            values = trace.data.astype(float)
            clock = str(trace.stats.starttime)
            channels.append(
                FileChannel(trace.stats.channel or trace.id, values, "", n, step, clock=clock, where=content.path)
            )
        return channels

    return FileFormat({"SAC": "SAC", "MSEED": "miniSEED"}[name], recognises, read)


SAC, MINISEED = _obspy_reader("SAC"), _obspy_reader("MSEED")
