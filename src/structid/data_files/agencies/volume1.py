"""Pairs of time and acceleration: uncorrected accelerograms (volume 1) of the film era, in seconds and G/10."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.data_files.base import FileChannel
from structid.data_files.file_content import FileContent, fixed_width
from structid.data_files.time_axis import constant_step

PAIRS_PER_LINE, _WIDTH = 5, 7
INTEGER_LINES, REAL_LINES = 7, 7
"""Lines of the integer-valued header (100 values) and of the real-valued header (50 values)."""


def channel_of_pairs(
    content: FileContent, start: int, points: int, name: str, number: int, indent: int = 0
) -> tuple[FileChannel, int]:
    """Read `points` pairs from the line `start`; return the channel and the index of the next line.

    The times are printed to 0.001 s. A digitised film has no constant step; a digital recorder has.
    """
    values, after = fixed_width(content, start, 2 * points, 2 * PAIRS_PER_LINE, _WIDTH, indent)
    times, acceleration = values[0::2], values[1::2]
    step = step_of_printed_times(content, start, times)
    channel = FileChannel(
        name=name,
        number=number,
        values=acceleration,
        unit="0.1 g",
        dt=step,
        times=None if step else times,
        start=float(times[0]),
        quantity="acceleration",
        where=content.at(start),
        notes=() if step else ("the samples are not at a constant step: points digitised from a film",),
    )
    return channel, after


def step_of_printed_times(content: FileContent, start: int, times: Float[np.ndarray, " time"]) -> float | None:
    """Return the constant step [s] of times printed to 0.001 s; None if the step varies."""
    if (np.diff(times) < 0.0).any():
        first = int(np.argmax(np.diff(times) < 0.0)) + 1
        raise InputError(
            content.at(start + first // PAIRS_PER_LINE),
            f"time {times[first]:g} s follows {times[first - 1]:g} s",
            "times that increase",
            "Download the file again, since it is damaged.",
        )
    try:
        return constant_step(times, content.at, rounding=0.0005)
    except InputError:
        return None
