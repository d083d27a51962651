"""Faults that a recorded history reveals by itself: an offset, a gap of zeros, clipping, a time column."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from structid.core.channels import ChannelUnit, base_channel
from structid.core.units import factor
from structid.data_files.inspection import FEWEST, flat_tops, zero_gaps
from structid.ground_motion.excitation import Excitation
from structid.observation import Observation

OFFSET = 2.0
"""Ratio of mean to standard deviation above which a measurement probably has an offset."""

OFFSET_OF_RATES = 0.5
"""The same ratio for velocities and accelerations, whose mean is nearly zero for a structure that stays in place."""

RATES = ("velocity", "relative_acceleration", "absolute_acceleration")
"""Channels that are velocities or accelerations."""

OFFSET_AT_REST = 0.02
"""Ratio of the mean before the record begins to the history's peak above which an offset is suspected."""

NOT_ZERO = np.finfo(np.float64).tiny
"""Stands for a missing value in the search for exact zeros: it is none, and not large."""

QUIET = 0.01
"""Fraction of its peak below which a record has not begun."""

STANDARD_ERRORS = 5.0
"""Number of standard errors above which noise does not explain the mean at rest."""

SHORTEST_REST = 0.5
"""Minimum duration of rest before a record begins [s] for an estimate of the mean at rest."""

STRAIGHT = 1e-4
"""Relative deviation from a straight line up to which a history is not considered a measurement."""


def questions_of_the_measurement(observation: Observation, units: Mapping[str, ChannelUnit]) -> list[str]:
    """Check the measured histories for faults that show without a model; return a question about each."""
    questions = []
    for index, channel in enumerate(observation.channels):
        known = observation.is_measured[:, index]
        values = observation.values[known, index]
        unit = units[channel].display
        problems = [_constant(channel, values, unit) or _straight(channel, values)]
        if not problems[0]:
            problems += [
                _offset(channel, values, observation.time[known], unit, observation),
                gap(f"measured {channel}", np.where(known, observation.values[:, index], NOT_ZERO), observation.step),
                clipped(f"measured {channel}", values, unit),
            ]
        questions += [sentence for sentence in problems if sentence]
    return questions


def gap(name: str, values: Float[np.ndarray, " time"], dt: float) -> str:
    """Question about exact zeros while the structure moves."""
    for begin, end in zero_gaps(values, dt):
        return (
            f"The {name} is exactly zero from {begin * dt:.4g} s to {(end - 1) * dt:.4g} s, next to large values. Did "
            "the recorder lose values? If so, cut the record and the measurement there."
        )
    return ""


def clipped(name: str, values: Float[np.ndarray, " time"], unit: str) -> str:
    """Question about flat tops at an extreme, which indicate that the measuring range is too small."""
    for extreme, tops in flat_tops(values):
        return (
            f"The {name} stays at its extreme value {extreme / factor(unit):.4g} {unit} for up to {max(tops)} samples, "
            f"{'once' if len(tops) == 1 else f'{len(tops)} times'}. Was the instrument at the end of its range? A clipped "
            "history cannot be used for a calibration."
        )
    return ""


def _constant(channel: str, values: np.ndarray, unit: str) -> str:
    """Question about a constant history, which a working sensor does not produce."""
    if len(values) < FEWEST or np.ptp(values) > 0.0:
        return ""
    return f"The measured {channel} is {values[0] / factor(unit):.3g} {unit} throughout. Did the sensor fail?"


def _straight(channel: str, values: np.ndarray) -> str:
    """Question about a straight line, which is not a structural response."""
    times = np.arange(len(values))
    if len(values) < FEWEST:
        return ""
    slope, start = np.polyfit(times, values, 1)
    if np.abs(values - start - slope * times).max() > STRAIGHT * np.ptp(values):
        return ""
    return (
        f"The measured {channel} is a straight line from {values[0]:.4g} to {values[-1]:.4g} in SI. Is it the time column? "
        "If so, set 'column' to the measured column; the first column is 0."
    )


def _offset(channel: str, values: np.ndarray, time: np.ndarray, unit: str, observation: Observation) -> str:
    """Question about a mean that is large relative to the history, or present before the record begins."""
    if observation.offset is not None:
        return ""
    mean, spread = float(values.mean()), float(values.std())
    cure = "Is it an offset of the instrument? If so, give 'offset' a prior, or subtract it."
    if abs(mean) > (OFFSET_OF_RATES if base_channel(channel) in RATES else OFFSET) * spread:
        return (
            f"The measured {channel} has a mean of {mean / factor(unit):.3g} {unit}, {abs(mean) / spread:.1f} "
            f"times its standard deviation. {cure}"
        )
    rest = _begin(observation.record) * observation.record.dt
    at_rest = values[time < rest]
    if len(at_rest) < max(FEWEST, SHORTEST_REST / observation.step):
        return ""
    mean, peak = float(at_rest.mean()), float(np.abs(values).max())
    error = float(at_rest.std()) / np.sqrt(len(at_rest))
    if abs(mean) <= max(OFFSET_AT_REST * peak, STANDARD_ERRORS * error):
        return ""
    return (
        f"The measured {channel} has a mean of {mean / factor(unit):.3g} {unit} in the {rest:.3g} s before the record begins, "
        f"{abs(mean) / peak:.0%} of its peak. {cure}"
    )


def _begin(record: Excitation) -> int:
    """Number of samples before an excitation first exceeds a fraction of its peak; 0 if it is zero everywhere."""
    size = np.abs(record.values)
    return int(np.argmax(size > QUIET * size.max())) if size.any() else 0
