"""Tracking indicators of a specimen, from commanded and measured displacements.

Sources: O. Mercan & J. M. Ricles (2007, Earthq. Eng. Struct. Dyn. 36, 1523) for the tracking indicator; T. Guo, C. Chen, W. Xu &
F. Sanchez (2014, Smart Mater. Struct. 23, 045042) for the frequency evaluation index.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError

LEAST_SECANT, OVER_NOISE = 0.1, 100.0
"""Minimum length of a secant, relative to the peak and to the noise; in shorter secants, noise would appear as stiffness."""
SURELY, FEWEST_FOR_NOISE = 3.0, 20
"""Number of standard deviations of force noise subtracted from a secant; minimum number of moves to estimate this noise."""
NORMAL_MEDIAN = 1.4826
"""Ratio of the standard deviation to the median absolute value, for a normal distribution with zero mean."""
STIFFER = 1.05
"""Ratio of secant stiffness to K₀ above which there is a warning."""


def root_mean_square_error(commanded: Float[np.ndarray, " time"], measured: Float[np.ndarray, " time"]) -> float:
    """RMS (u_m − u_c) over RMS u_c."""
    scale = np.sqrt(np.mean(commanded**2))
    return float(np.sqrt(np.mean((measured - commanded) ** 2)) / scale) if scale > 0.0 else np.nan


def tracking_indicator(
    commanded: Float[np.ndarray, " time"], measured: Float[np.ndarray, " time"]
) -> Float[np.ndarray, " time"]:
    """½ (∮ u_c du_m − ∮ u_m du_c): the area enclosed in the synchronisation subspace, which grows while the specimen lags."""
    # ∫ x dy by trapezoids leaves ½ Σ (x₀ y₁ − x₁ y₀) for the difference.
    steps = commanded[:-1] * measured[1:] - commanded[1:] * measured[:-1]
    return np.concatenate([[0.0], 0.5 * np.cumsum(steps)])


def energy_error(
    force: Float[np.ndarray, " time"], commanded: Float[np.ndarray, " time"], measured: Float[np.ndarray, " time"]
) -> Float[np.ndarray, " time"]:
    """∫ r d(u_m − u_c): the energy that the tracking error feeds into the structure."""
    energy = scipy.integrate.cumulative_trapezoid(force, measured - commanded, initial=0.0)
    return np.asarray(energy)


@dataclass(frozen=True)
class FrequencyEvaluationIndex:
    """Amplitude and delay of a measured motion, weighted by the power of the command."""

    amplitude: float  # |F|; 1 for perfect tracking
    delay: float  # −arg F/(2π f_eq) [s], in the time base of the histories
    frequency: float  # f_eq, mean frequency weighted by the same power [Hz]


def frequency_evaluation_index(
    commanded: Float[np.ndarray, " time"], measured: Float[np.ndarray, " time"], dt: float
) -> FrequencyEvaluationIndex:
    """F = Σ (U_m/U_c) |U_c|² / Σ |U_c|² over the frequencies of a history."""
    # Without a taper, a history with different ends would leak into all frequencies.
    taper = np.hanning(len(commanded))
    u_c, u_m = (np.fft.rfft(taper * scipy.signal.detrend(u))[1:] for u in (commanded, measured))
    power = np.abs(u_c) ** 2
    if not power.sum() > 0.0:
        raise InputError("frequency_evaluation_index", "no commanded movement", "a command that is not zero")
    ratio = np.sum(u_m * np.conj(u_c)) / power.sum()
    frequency = float(np.sum(np.fft.rfftfreq(len(commanded), dt)[1:] * power) / power.sum())
    return FrequencyEvaluationIndex(
        float(np.abs(ratio)), float(-np.angle(ratio) / (2.0 * np.pi * frequency)), frequency
    )


def largest_secant(
    measured: Float[np.ndarray, "move channel"],
    target: Float[np.ndarray, "move channel"],
    force: Float[np.ndarray, "move channel"],
    stiffness: Float[np.ndarray, "channel channel"],
) -> float:
    """Largest stiffness of the specimen along its path, relative to K₀: Δuᵀ Δr / Δuᵀ K₀ Δu.

    Each secant is at least as long as a tenth of the peak displacement and 100 times the noise. Secants across a
    turning point are omitted, because a hysteretic force differs there at equal displacements. The likely maximum
    contribution of force noise is subtracted.
    """
    peak = float(np.abs(measured).max(initial=0.0))
    noise = float(np.diff(measured - target, axis=0).std() / np.sqrt(2.0)) if len(measured) > 2 else 0.0
    least = max(LEAST_SECANT * peak, OVER_NOISE * noise)
    doubt = SURELY * np.sqrt(2.0) * _force_noise(measured, force, stiffness)
    largest, last, before = np.nan, 0, None
    for k in range(1, len(measured) if peak > 0.0 else 0):
        change = measured[k] - measured[last]
        if np.abs(change).max() < least:
            continue
        if before is not None and before @ change > 0.0:
            work = change @ (force[k] - force[last]) - np.abs(change) @ doubt
            largest = float(np.fmax(largest, work / (change @ stiffness @ change)))
        last, before = k, change
    return largest


def _force_noise(measured: np.ndarray, force: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Standard deviation of the force noise, from residuals of a linear response, shape (channel,).

    Third differences of smooth histories are small; third differences of independent noise have √20 times its standard deviation.
    """
    if len(force) < FEWEST_FOR_NOISE:
        return np.zeros(force.shape[1])
    linear = measured @ stiffness
    size = np.sum(linear**2)
    rest = force - (np.sum(force * linear) / size if size > 0.0 else 0.0) * linear
    rough = np.median(np.abs(np.diff(rest, n=3, axis=0)), axis=0)
    return np.asarray(NORMAL_MEDIAN * rough / np.sqrt(20.0))
