"""The constant time step of printed times."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np
from jaxtyping import Float, Int

from structid.core.errors import InputError

ROUNDED_TIME = 0.05
"""Largest error of a printed time, as a fraction of the time step."""

ROUNDED_FOR_A_STEP = 0.3
"""The same if the time step is given."""

SAME_STEP = 1e-3
"""Relative difference below which printed times have a given step."""

SORT = "Sort the lines by time, remove doubled lines, or give the time step, such as dt=0.01."
"""Remedy for times that are no multiples of a step although lines may be missing."""

LARGEST_DENOMINATOR = 100_000
"""Largest denominator of a time step, as a fraction of a second; no instrument needs a larger denominator."""


def constant_step(times: Float[np.ndarray, " time"], at: Callable[[int], str], rounding: float = 0.0) -> float:
    """Return the step [s] of printed times; refuse a varying step, and name the first irregular line.

    `at` names the line of a sample. Times printed with a known rounding error may deviate by that error.
    """
    step = float(times[-1] - times[0]) / (times.size - 1)
    # Times may be printed with few digits: deviations in the last digit are allowed, deviations near one time step are not.
    deviation = float(np.abs(times - times[0] - step * np.arange(times.size)).max())
    if step <= 0.0 or deviation > max(ROUNDED_TIME * step, min(2.0 * rounding, 0.45 * step)):
        raise _irregular(times, at)
    # All times together give the step more precisely than one difference. The error is twice the rounding of the end times.
    return _simplest_step(step, max(2.0 * deviation / (times.size - 1), 1e-12 * step))


def step_with_gaps(
    times: Float[np.ndarray, " row"], at: Callable[[int], str], dt: float | None = None
) -> tuple[float, Int[np.ndarray, " row"]]:
    """Return the step [s] of printed times of which some are missing, and the sample of each row.

    Times that are no multiples of the usual step, or of a given one, are refused.
    """
    if len(times) < 2:
        raise InputError(at(0), f"{len(times)} times", "two or more times", "Give the time step, such as dt=0.01.")
    steps = np.diff(times)
    median = float(np.median(steps))
    if median <= 0.0:
        raise _irregular(times, at, SORT)
    # Printed times are rounded: the mean of the regular steps is more precise than their median.
    usual = float(steps[np.abs(steps - median) < 0.5 * median].mean()) if dt is None else dt
    samples = np.concatenate([[0], np.cumsum(np.rint(steps / usual).astype(int))])
    step = float(times[-1] - times[0]) / max(int(samples[-1]), 1)
    deviation = float(np.abs(times - times[0] - step * samples).max())
    allowed = ROUNDED_TIME if dt is None else ROUNDED_FOR_A_STEP
    if (np.diff(samples) < 1).any() or deviation > allowed * step:
        raise _irregular(times, at, SORT)
    if dt is not None and abs(step / dt - 1.0) > SAME_STEP:
        raise InputError(
            at(1), f"the times increase by {step:.6g} s, but dt={dt:g} is given", "one time step", "Leave dt out."
        )
    if dt is not None:
        return dt, samples
    return _simplest_step(step, max(2.0 * deviation / samples[-1], 1e-12 * step)), samples


def _simplest_step(step: float, resolution: float) -> float:
    """Return the step that was probably printed, a fraction with a small denominator, within a resolution."""
    simplest = _simplest_fraction(Fraction(step - resolution), Fraction(step + resolution))
    return float(simplest) if simplest.denominator <= LARGEST_DENOMINATOR else float(f"{step:.9g}")


def _irregular(times: np.ndarray, at: Callable[[int], str], cure: str = "") -> InputError:
    """Name the first time that does not follow the usual step."""
    steps = np.diff(times)
    usual = float(np.median(steps))
    irregular = np.flatnonzero(np.abs(steps - usual) > 2.0 * ROUNDED_TIME * abs(usual))
    index = int(irregular[0]) + 1 if irregular.size else int(np.argmin(steps)) + 1
    return InputError(
        at(index),
        f"time {times[index]:.9g} s follows {times[index - 1]:.9g} s, but the usual step is {usual:.6g} s",
        "times that increase by a constant step",
        cure
        or "Resample the record to a constant step first. If lines are missing in a measurement, set missing = 'leave_out'. If "
        "numbers have decimal commas, separate the columns by semicolons.",
    )


def _simplest_fraction(low: Fraction, high: Fraction) -> Fraction:
    """Return the fraction with the smallest denominator in an interval: 1/256 for 0.0039062 to 0.0039063."""
    whole = low.numerator // low.denominator
    if whole == low:
        return low
    if whole + 1 <= high:
        return Fraction(whole + 1)
    return whole + 1 / _simplest_fraction(1 / (high - whole), 1 / (low - whole))
