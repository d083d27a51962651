"""Processing of a sampled signal: baseline correction, zero-phase Butterworth filters, resampling, integration."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import scipy

from structid.errors import InputError, check_choice

PASSBAND_LOSS = 3.0
"""Attenuation at the edge of the passband, for one pass [dB]."""
STOPBAND_LOSS = 8.0
"""Attenuation at the edge of the stopband, for one pass [dB]."""
STOPBAND_RATIO = 1.25
"""Stopband edge divided by passband edge: 25 Hz for 20 Hz."""


LOWEST_EDGE = 1e-5
"""Lowest edge of a filter, as a share of the Nyquist frequency: below it the filter is singular in float64."""
MOST_ORDER = 30
"""Highest order of a filter."""


def remove_baseline(signal: np.ndarray, kind: str = "constant") -> np.ndarray:
    """Subtract the mean or the least-squares line.

    Parameters
    ----------
    signal : ndarray, shape (time,)
        The samples.
    kind : {"constant", "linear"}
        What to subtract.

    Returns
    -------
    ndarray, shape (time,)
        The corrected signal.
    """
    corrected: np.ndarray = scipy.signal.detrend(signal, type=check_choice("baseline", kind, ("constant", "linear")))
    return corrected


def butterworth_order(edge: float, dt: float, stop: float | None = None) -> int:
    """Smallest digital Butterworth order that attenuates by 3 dB at the passband edge and 8 dB at the stopband edge.

    Parameters
    ----------
    edge : float
        Passband edge [Hz].
    dt : float
        Time step [s].
    stop : float, optional
        Stopband edge [Hz]; 1.25 × `edge` by default.

    Returns
    -------
    int
        The order; 3 for 20 and 25 Hz at 0.01 s.
    """
    stop = STOPBAND_RATIO * edge if stop is None else stop
    nyquist = 0.5 / dt
    if not 0 < edge < nyquist:
        raise InputError("filter edge", f"{edge:g} Hz", f"between 0 and the Nyquist frequency {nyquist:g} Hz")
    order, _ = scipy.signal.buttord(edge, min(stop, 0.99 * nyquist), PASSBAND_LOSS, STOPBAND_LOSS, fs=1.0 / dt)
    return int(order)


def butterworth(signal: np.ndarray, dt: float, edges: float | tuple[float, float], band: str, order: int) -> np.ndarray:
    """Filter forward and backward: no phase shift, and twice the attenuation (6 dB at the edge).

    Parameters
    ----------
    signal : ndarray, shape (time,)
        The samples.
    dt : float
        Time step [s].
    edges : float or pair of float
        Edge or edges of the passband [Hz].
    band : {"lowpass", "highpass", "bandpass"}
        The frequencies that pass.
    order : int
        Order of one pass.

    Returns
    -------
    ndarray, shape (time,)
        The filtered signal.
    """
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
            "The filter would take longer than the record to respond.",
        )
    if not 1 <= order <= MOST_ORDER:
        raise InputError(f"{band} order", f"{order}", f"1 to {MOST_ORDER}")
    sections = scipy.signal.butter(order, edges, band, fs=1.0 / dt, output="sos")
    if signal.size <= 3 * (2 * len(sections) + 1):
        raise InputError(band, f"a record of {signal.size} samples", f"more than {3 * (2 * len(sections) + 1)} samples")
    filtered: np.ndarray = scipy.signal.sosfiltfilt(sections, signal)
    return filtered


def resample(signal: np.ndarray, dt: float, new_dt: float) -> np.ndarray:
    """Resample with a polyphase anti-aliasing filter.

    Parameters
    ----------
    signal : ndarray, shape (time,)
        The samples.
    dt, new_dt : float
        Present and new step [s]; their ratio must be a fraction of whole numbers up to 1000.

    Returns
    -------
    ndarray, shape (new time,)
        The resampled signal.
    """
    if not new_dt > 0:
        raise InputError("resample: dt", f"{new_dt:g} s", "a positive step")
    ratio = Fraction(dt / new_dt).limit_denominator(1000)
    if abs(float(ratio) * new_dt / dt - 1.0) > 1e-9:
        raise InputError("resample: dt", f"{new_dt:g} s from {dt:g} s", "steps whose ratio is a simple fraction")
    resampled: np.ndarray = scipy.signal.resample_poly(signal, ratio.numerator, ratio.denominator)
    return resampled


def integrate(signal: np.ndarray, dt: float) -> np.ndarray:
    """Integrate over time by the trapezoidal rule, from zero.

    Parameters
    ----------
    signal : ndarray, shape (..., time)
        The samples.
    dt : float
        Time step [s].

    Returns
    -------
    ndarray, shape (..., time)
        The integral.
    """
    integral: np.ndarray = scipy.integrate.cumulative_trapezoid(signal, dx=dt, initial=0.0, axis=-1)
    return integral
