"""Processing of a signal: baseline correction, zero-phase Butterworth filters, resampling, integration."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import scipy
from jaxtyping import Bool, Float

from structid.core.errors import InputError, check_choice

PASSBAND_LOSS = 3.0
"""Attenuation at the edge of the passband, for one pass [dB]."""
STOPBAND_LOSS = 8.0
"""Attenuation at the edge of the stopband, for one pass [dB]."""
STOPBAND_RATIO = 1.25
"""Stopband edge divided by passband edge: 25 Hz for 20 Hz."""


LOWEST_EDGE = 1e-5
"""Lowest edge of a filter as a fraction of the Nyquist frequency; below it the filter is singular in float64."""
MOST_ORDER = 30
"""Highest order of a filter."""
SETTLED = 1e-8
"""Fraction of a filter's free response that may remain at the start of the signal."""
LONGEST_PADDING = 20
"""Largest number of samples by which a signal is extended at each end, as a multiple of its length."""
MOST_SAMPLES = 20_000_000
"""Maximum number of samples of a signal: two days at 100 Hz. Longer signals are probably a mistake and would fill the memory."""
KERNEL, KAISER = 10, 5.0
"""Half-length of the anti-aliasing kernel in samples of the coarser step, and the parameter of its Kaiser window."""
DRIFT = 0.01
"""Largest error, in samples, that a rounded step may accumulate over a signal."""


def check_samples(where: str, samples: float) -> None:
    """Refuse an implausibly long signal."""
    if not samples <= MOST_SAMPLES:
        raise InputError(where, f"a signal of {samples:.3g} samples", f"at most {MOST_SAMPLES:,} samples")


def remove_baseline(signal: Float[np.ndarray, " time"], kind: str = "constant") -> Float[np.ndarray, " time"]:
    """Subtract the mean or the least-squares line."""
    corrected: np.ndarray = scipy.signal.detrend(signal, type=check_choice("baseline", kind, ("constant", "linear")))
    return corrected


def between(time: Float[np.ndarray, " time"], begin: float, end: float) -> Bool[np.ndarray, " time"]:
    """Return a mask of the samples from one time to another, both included; times may be rounded."""
    tolerance = 1e-6 * (time[1] - time[0]) if len(time) > 1 else 0.0
    return np.asarray((time >= begin - tolerance) & (time <= end + tolerance))


def remove_offset(
    values: Float[np.ndarray, "time *column"],
    time: Float[np.ndarray, " time"],
    rest: Sequence[tuple[float, float]],
    where: str,
) -> Float[np.ndarray, "time *column"]:
    """Subtract the mean of the known values in a stretch at rest, or the line through the means of two stretches."""
    means, middles = [], []
    for begin, end in rest:
        inside = between(time, begin, end)
        if not np.isfinite(values[inside]).any():
            raise InputError(
                where,
                f"no value between {begin:g} and {end:g} s",
                f"two times between {time[0]:.6g} and {time[-1]:.6g} s, the first before the second",
            )
        known = inside & np.isfinite(values.reshape(len(time), -1)).all(axis=1)
        means.append(values[known].mean(axis=0))
        middles.append(time[known].mean())
    if len(rest) == 1:
        return np.asarray(values - means[0])
    if middles[0] == middles[1]:
        raise InputError(where, "twice the same stretch", "two stretches at rest, such as before and after the motion")
    slope = (means[1] - means[0]) / (middles[1] - middles[0])
    return np.asarray(values - means[0] - np.multiply.outer(time - middles[0], slope))


def stretches(given: Any, where: str) -> list[tuple[float, float]]:
    """Return one or two stretches of time [s] from a pair of times, or from two pairs, after a check."""
    pairs = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else []
    several = len(pairs) == 2 and all(isinstance(pair, Sequence) and not isinstance(pair, str) for pair in pairs)
    return [pair_of_times(pair, where) for pair in (pairs if several else [given])]


def pair_of_times(given: Any, where: str) -> tuple[float, float]:
    """Return begin and end of a stretch [s], after a check."""
    pair = tuple(given) if isinstance(given, Sequence) and not isinstance(given, str) else ()
    if len(pair) != 2 or not all(isinstance(time, (int, float)) and not isinstance(time, bool) for time in pair):
        raise InputError(where, f"{given!r}", "a pair of times in seconds, such as (9.1, 9.8)")
    return float(pair[0]), float(pair[1])


def butterworth_order(edge: float, dt: float, stop: float | None = None) -> int:
    """Return the smallest digital Butterworth order with 3 dB attenuation at the passband edge and 8 dB at the stopband edge."""
    stop = STOPBAND_RATIO * edge if stop is None else stop
    nyquist = 0.5 / dt
    if not 0 < edge < nyquist:
        raise InputError("filter edge", f"{edge:g} Hz", f"between 0 and the Nyquist frequency, {nyquist:g} Hz")
    order, _ = scipy.signal.buttord(edge, min(stop, 0.99 * nyquist), PASSBAND_LOSS, STOPBAND_LOSS, fs=1.0 / dt)
    return int(order)


def butterworth(
    signal: Float[np.ndarray, " time"], dt: float, edges: float | tuple[float, float], band: str, order: int
) -> Float[np.ndarray, " time"]:
    """Filter forward and backward, with no phase shift and with twice the attenuation (6 dB at the edge)."""
    nyquist = 0.5 / dt
    pair = np.atleast_1d(edges)
    if not (np.all(pair > 0) and np.all(pair < nyquist) and np.all(np.diff(pair) > 0)):
        raise InputError(
            f"{band} edge",
            f"{edges} Hz",
            f"increasing frequencies between 0 and the Nyquist frequency {nyquist:g} Hz",
        )
    if pair.min() < LOWEST_EDGE * nyquist:
        raise InputError(
            f"{band} edge",
            f"{edges} Hz at a time step of {dt:g} s",
            f"{LOWEST_EDGE * nyquist:g} Hz or more",
            "Raise the edge: the filter's response time would exceed the record.",
        )
    if not 1 <= order <= MOST_ORDER:
        raise InputError(f"{band} order", f"{order}", f"an order from 1 to {MOST_ORDER}")
    sections = scipy.signal.butter(order, edges, band, fs=1.0 / dt, output="sos")
    if signal.size <= 3 * (2 * len(sections) + 1):
        raise InputError(band, f"a record of {signal.size} samples", f"more than {3 * (2 * len(sections) + 1)} samples")
    samples = np.arange(signal.size)
    # The filtered signal near the ends depends on the extension there. For a low-pass the extension continues the slope; for
    # a high-pass it continues the mean, after a straight line is subtracted (a high-pass turns the line into zero anyway).
    if band == "lowpass":
        level, reflected = np.zeros(signal.size), "odd"
    else:
        level, reflected = np.polynomial.Polynomial.fit(samples, signal, 1)(samples), "even"
    beyond = min(_settling_samples(sections), LONGEST_PADDING * signal.size)
    padded = np.pad(signal - level, beyond, mode="reflect", reflect_type=reflected)  # type: ignore[call-overload]
    filtered: np.ndarray = scipy.signal.sosfiltfilt(sections, padded)[beyond : beyond + signal.size]
    return filtered


def _settling_samples(sections: np.ndarray) -> int:
    """Return the number of samples after which a filter's free response decays to `SETTLED`, for its slowest pole."""
    _, poles, _ = scipy.signal.sos2zpk(sections)
    return int(np.ceil(np.log(SETTLED) / np.log(np.abs(poles).max())))


def resample(signal: Float[np.ndarray, " time"], dt: float, new_dt: float) -> Float[np.ndarray, " new_time"]:
    """Resample with a polyphase anti-aliasing filter.

    The signal is extended at its ends by odd reflection, so that a constant signal stays constant.
    """
    if not new_dt > 0:
        raise InputError("resample: dt", f"{new_dt:g} s", "a positive time step")
    ratio = Fraction(dt / new_dt).limit_denominator(1000)
    up, down = ratio.numerator, ratio.denominator
    if up == 0 or abs(up / down * new_dt / dt - 1.0) * signal.size > DRIFT:
        nearest = f"{dt * down / up:.9g} s" if up else f"{1000 * dt:g} s"
        raise InputError(
            "resample: dt",
            f"{new_dt:.9g} s from {dt:.9g} s",
            "time steps whose ratio is a fraction of whole numbers up to 1000",
            f"Use the nearest such step, {nearest}.",
        )
    check_samples("resample: dt", signal.size * up / down)
    if up == down:
        return signal.copy()
    # The extension at the start is a whole number of coarse steps, so that the time of the first sample does not change.
    beyond = down * (KERNEL * max(up, down) // (up * down) + 1)
    padded = np.pad(signal, beyond, mode="reflect", reflect_type="odd")
    first, samples = beyond * up // down, (signal.size - 1) * up // down + 1
    kernel = _resampling_kernel(up, down)
    resampled: np.ndarray = scipy.signal.resample_poly(padded, up, down, window=kernel)[first : first + samples]
    return resampled


def _resampling_kernel(up: int, down: int) -> np.ndarray:
    """Return a low-pass at the smaller Nyquist frequency. Each of its `up` phases sums to one, so a constant has no ripple."""
    half = KERNEL * max(up, down)
    kernel = scipy.signal.firwin(2 * half + 1, 1.0 / max(up, down), window=("kaiser", KAISER))
    phase = (np.arange(kernel.size) - half) % up
    sums = np.bincount(phase, kernel, minlength=up)
    return np.asarray(kernel / (up * sums[phase]))


def integrate(signal: Float[np.ndarray, "... time"], dt: float) -> Float[np.ndarray, "... time"]:
    """Integrate over time by the trapezoidal rule, starting from zero."""
    integral: np.ndarray = scipy.integrate.cumulative_trapezoid(signal, dx=dt, initial=0.0, axis=-1)
    return integral
