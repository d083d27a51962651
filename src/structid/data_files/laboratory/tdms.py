"""TDMS (LabVIEW, National Instruments), read by npTDMS (an extra)."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from structid.core.errors import InputError
from structid.data_files.base import FileChannel, FileFormat, check_step, optional_library
from structid.data_files.file_content import FileContent
from structid.data_files.tables.titles import is_time
from structid.data_files.time_axis import constant_step
from structid.data_files.unit_spellings import seconds_of, spelt_unit

_TIME_NAMES = ("timestamp", "time stamp")


def recognises(content: FileContent) -> bool:
    """Whether the file begins with the tag of a segment."""
    return content.raw[:4] == b"TDSm"


def read(content: FileContent) -> list[FileChannel]:
    """Read all channels; the step is the waveform's increment, or that of a channel named time in the same group."""
    nptdms = optional_library(content, "nptdms", "a TDMS file", "laboratory")
    try:
        groups = nptdms.TdmsFile.read(io.BytesIO(content.raw)).groups()
    except Exception as cause:
        raise InputError(
            content.path, f"npTDMS cannot read it: {cause}", "a TDMS file", "Copy the file again."
        ) from cause
    channels: list[FileChannel] = []
    for group in groups:
        times = next((c for c in group.channels() if is_time(c.name) or c.name.lower() in _TIME_NAMES), None)
        for channel in group.channels():
            if channel is not times and len(channel) and np.issubdtype(np.asarray(channel[:]).dtype, np.number):
                channels.append(_channel(content, group, channel, times, len(channels) + 1))
    if not channels:
        raise InputError(content.path, "no channel of numbers", "channels of numbers", "Export the channels again.")
    return channels


def _channel(content: FileContent, group: Any, channel: Any, times: Any, number: int) -> FileChannel:
    """Return one channel with its unit and its step."""
    where = f"{content.path}, group '{group.name}', channel '{channel.name}'"
    unit = str(channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription") or "")
    step, start = _waveform(channel, where)
    if not step and times is not None and len(times) == len(channel):
        seconds = _times(times, where)
        step, start = constant_step(seconds, lambda n: f"{where}, sample {n}"), float(seconds[0])
    values = np.asarray(channel[:], dtype=float)
    if not step:
        samples = np.arange(len(values), dtype=float)
        return FileChannel(
            channel.name, values, spelt_unit(unit) or "", number, times=samples, counted=True, where=where
        )
    return FileChannel(
        channel.name, values, spelt_unit(unit) or "", number, check_step(where, float(step)), start=start, where=where
    )


def _waveform(channel: Any, where: str) -> tuple[float, float]:
    """Return increment and offset of a waveform [s]; 0 without. Its axis must be a time."""
    properties = channel.properties
    axis = str(properties.get("wf_xunit_string") or "s")
    factor = seconds_of(axis)
    try:
        step, start = (float(properties.get(key) or 0.0) for key in ("wf_increment", "wf_start_offset"))
    except (TypeError, ValueError):
        raise InputError(
            where, "a waveform increment or offset that is no number", "numbers", "Export it again."
        ) from None
    if step and factor is None:
        raise InputError(where, f"an axis in '{axis}'", "an axis of times", "Export the history and not its spectrum.")
    return step * (factor or 1.0), start * (factor or 1.0)


def _times(times: Any, where: str) -> np.ndarray:
    """Return the times of a channel [s]."""
    values = np.asarray(times[:])
    if np.issubdtype(values.dtype, np.datetime64):
        return np.asarray((values - values[0]).astype("timedelta64[ns]").astype(float) * 1e-9)
    unit = str(times.properties.get("unit_string") or "s")
    factor = seconds_of(unit)
    if factor is None:
        raise InputError(where, f"times in '{unit}'", "times in s, ms or µs", "Export the times in seconds.")
    return values.astype(float) * factor


FORMAT = FileFormat("TDMS", recognises, read)
