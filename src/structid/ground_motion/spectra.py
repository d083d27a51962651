"""Spectra and intensity measures of a record: Fourier amplitude, response spectra, Arias intensity, duration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.units import STANDARD_GRAVITY
from structid.ground_motion.processing import integrate

DEFAULT_PERIODS = np.geomspace(0.02, 10.0, 120)
"""Oscillator periods of a response spectrum [s]."""
DEFAULT_PERIODS.setflags(write=False)
SHORTEST_PERIOD = 0.01
"""Shortest period as a fraction of the record's time step; at this period the spectrum equals the PGA."""


class ResponseSpectrum(NamedTuple):
    """Peak responses of linear oscillators to a ground motion; each array has shape (period,)."""

    period: np.ndarray
    displacement: np.ndarray
    pseudo_velocity: np.ndarray
    pseudo_acceleration: np.ndarray


def fourier_amplitude(signal: Float[np.ndarray, " time"], dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute the Fourier amplitude spectrum |Σ x exp(−iωt)| dt."""
    return np.fft.rfftfreq(signal.size, dt), np.abs(np.fft.rfft(signal)) * dt


def arias_history(acceleration: Float[np.ndarray, " time"], dt: float) -> Float[np.ndarray, " time"]:
    """Compute the Arias intensity up to each sample, π/(2g) ∫ a² dt."""
    return np.pi / (2.0 * STANDARD_GRAVITY) * integrate(acceleration**2, dt)


def significant_duration(
    acceleration: Float[np.ndarray, " time"], dt: float, start: float = 0.05, end: float = 0.95
) -> float:
    """Compute the time between two fractions of the Arias intensity."""
    history = arias_history(acceleration, dt)
    times = np.interp(np.array([start, end]) * history[-1], history, np.arange(history.size) * dt)
    return float(times[1] - times[0])


def oscillator_displacement(
    acceleration: Float[np.ndarray, " time"], dt: float, period: float, damping_ratio: float = 0.05
) -> Float[np.ndarray, " fine_time"]:
    """Compute the relative displacement of a linear oscillator, exact for a record that is linear between samples.

    The recurrence of Nigam & Jennings (1969, Bull. Seism. Soc. Am. 59, 909) solves u″ + 2ζω u′ + ω² u = −a_g. Its time step
    is dt/⌈10 dt/T⌉, so that it captures the peaks of stiff oscillators between samples.
    """
    refinement = int(np.ceil(10.0 * dt / period))
    fine = np.interp(
        np.arange((acceleration.size - 1) * refinement + 1) / refinement,
        np.arange(acceleration.size),
        acceleration,
    )
    omega = 2.0 * np.pi / period
    system = (
        np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping_ratio * omega]]),
        np.array([[0.0], [-1.0]]),
        np.array([[1.0, 0.0]]),
        np.array([[0.0]]),
    )
    a, b, c, d, _ = scipy.signal.cont2discrete(system, dt / refinement, method="foh")
    # First-order hold gives the piecewise-linear recurrence. As a filter it runs in compiled code. Its numerator comes from
    # the Markov parameters, which are accurate even if the step is a tiny fraction of the period.
    trace, determinant = a[0, 0] + a[1, 1], a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    h0, h1, h2 = d[0, 0], (c @ b)[0, 0], (c @ a @ b)[0, 0]
    numerator = [h0, h1 - trace * h0, h2 - trace * h1 + determinant * h0]
    # The oscillator is at rest at the first sample. With zero delays the filter would assume that the record rises from zero in
    # the preceding step, and a slow oscillator would start with a velocity. So the delays give u₀ = 0, u₁ = p a₀ + h₀ a₁.
    held = scipy.signal.cont2discrete(system, dt / refinement, method="zoh")[1][0, 0]
    p = held - h0
    delays = np.array([-numerator[0], p - numerator[1]]) * fine[0]
    displacement: np.ndarray = scipy.signal.lfilter(numerator, [1.0, -trace, determinant], fine, zi=delays)[0]
    return displacement


def response_spectrum(
    acceleration: Float[np.ndarray, " time"],
    dt: float,
    periods: Float[np.ndarray, " period"] | None = None,
    damping_ratio: float = 0.05,
) -> ResponseSpectrum:
    """Compute peak displacement, pseudo-velocity and pseudo-acceleration of linear oscillators."""
    periods = np.asarray(DEFAULT_PERIODS if periods is None else periods, dtype=np.float64)
    if periods.ndim != 1 or not periods.size:
        raise InputError("periods", f"an array of shape {periods.shape}", "one or more periods in one dimension")
    wrong = periods[~(np.isfinite(periods) & (periods >= SHORTEST_PERIOD * dt))]
    if wrong.size:
        raise InputError(
            "periods",
            f"{wrong[0]:g} s",
            f"periods of at least {SHORTEST_PERIOD * dt:g} s, a hundredth of the time step; for T = 0 use the PGA",
        )
    if not 0.0 <= damping_ratio < 1.0:
        raise InputError("damping_ratio", f"{damping_ratio:g}", "at least 0 and below 1, such as 0.05 for 5 %")
    peak = np.array([np.abs(oscillator_displacement(acceleration, dt, t, damping_ratio)).max() for t in periods])
    omega = 2.0 * np.pi / periods
    return ResponseSpectrum(periods, peak, omega * peak, omega**2 * peak)


def rotd(first: Float[np.ndarray, " time"], second: Float[np.ndarray, " time"], percentile: float = 50.0) -> float:
    """Return a percentile, over all directions, of the peak of two horizontal components (Boore 2010, RotD50)."""
    angles = np.deg2rad(np.arange(180))
    # In any direction, the peak over time is at a vertex of the orbit's convex hull, which has few points.
    points = np.column_stack([first, second])
    try:
        hull = points[scipy.spatial.ConvexHull(points).vertices]
    except scipy.spatial.QhullError:  # both components along one line
        hull = points
    peaks = np.abs(hull @ np.vstack([np.cos(angles), np.sin(angles)])).max(axis=0)
    return float(np.percentile(peaks, percentile))


def rotd_spectrum(
    first: Float[np.ndarray, " time"],
    second: Float[np.ndarray, " other_time"],
    dt: float,
    periods: Float[np.ndarray, " period"],
    damping_ratio: float = 0.05,
) -> Float[np.ndarray, " period"]:
    """Compute the RotD50 pseudo-acceleration spectrum of two horizontal components."""
    samples = min(first.size, second.size)
    spectrum = []
    for period in periods:
        x = oscillator_displacement(first[:samples], dt, period, damping_ratio)
        y = oscillator_displacement(second[:samples], dt, period, damping_ratio)
        spectrum.append((2 * np.pi / period) ** 2 * rotd(x, y))
    return np.array(spectrum)
