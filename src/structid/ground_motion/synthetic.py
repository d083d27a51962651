"""A stochastic ground motion: filtered white noise whose frequency and intensity change with time.

Source: S. Rezaeian & A. Der Kiureghian (2010), "Simulation of synthetic ground motions for specified earthquake and
site characteristics", Earthquake Engng Struct. Dyn. 39, 1155-1180, doi 10.1002/eqe.997.
"""

from __future__ import annotations

import functools

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.streams import Purpose, stream
from structid.core.units import STANDARD_GRAVITY

CORNER_FREQUENCY = 0.1
"""Corner frequency of the critically damped high-pass oscillator [Hz]."""


def modulating_function(
    time: Float[np.ndarray, " time"], arias: float, duration: float, middle: float
) -> Float[np.ndarray, " time"]:
    """Compute the gamma-type modulating function q(t) = α₁ t^(α₂−1) exp(−α₃ t) from three physical measures.

    q² is proportional to a gamma density of shape 2α₂ − 1 and rate 2α₃. The times of 5, 45 and 95 % of the Arias intensity
    are therefore quantiles of this density.
    """

    def ratio(log_shape: float) -> float:
        q05, q45, q95 = scipy.stats.gamma.ppf([0.05, 0.45, 0.95], np.exp(log_shape))
        return float((q95 - q05) / q45 - duration / middle)

    low, high = np.log(0.3), np.log(1e4)
    if ratio(low) * ratio(high) > 0:
        raise InputError(
            "synthetic record",
            f"duration {duration:g} s with middle {middle:g} s",
            "a duration between 0.04 and 20 times the middle",
        )
    shape = float(np.exp(scipy.optimize.brentq(ratio, low, high)))
    scale = middle / scipy.stats.gamma.ppf(0.45, shape)
    # π/(2g) ∫ q² dt = I_a
    density: np.ndarray = scipy.stats.gamma.pdf(time, shape, scale=scale)
    modulation: np.ndarray = np.sqrt(2.0 * STANDARD_GRAVITY / np.pi * arias * density)
    return modulation


def filtered_noise(
    rng: np.random.Generator, samples: int, dt: float, frequency: Float[np.ndarray, " time"], damping_ratio: float
) -> Float[np.ndarray, " time"]:
    """Pass white noise through a filter whose frequency changes with time, and scale it to unit variance.

    x(t) = Σ_i h(t − t_i; ω_i) w_i / σ_h(t),  h(τ; ω) = ω/√(1−ζ²) exp(−ζωτ) sin(ω√(1−ζ²) τ)
    """
    noise = rng.standard_normal(samples)
    omega = 2.0 * np.pi * frequency
    root = np.sqrt(1.0 - damping_ratio**2)
    time = np.arange(samples) * dt
    motion, variance = np.zeros(samples), np.zeros(samples)
    # Each pulse is computed until it has decayed: exp(−ζωτ) < 1e-7.
    lives = np.minimum(np.ceil(16.0 / (damping_ratio * omega) / dt).astype(int) + 1, samples)
    for i in range(samples):
        lag = time[: min(lives[i], samples - i)]
        pulse = omega[i] / root * np.exp(-damping_ratio * omega[i] * lag) * np.sin(omega[i] * root * lag)
        motion[i : i + lag.size] += pulse * noise[i]
        variance[i : i + lag.size] += pulse**2
    normalised: np.ndarray = motion / np.sqrt(np.maximum(variance, variance.max() * 1e-12))
    return normalised


# The result is cached, because a study reads its record several times.
@functools.lru_cache(maxsize=32)
def stochastic_acceleration(
    seed: int,
    samples: int,
    dt: float,
    arias: float,
    duration: float,
    middle: float,
    frequency: float,
    frequency_slope: float,
    damping_ratio: float,
) -> Float[np.ndarray, " time"]:
    """Simulate one realisation of the stochastic ground acceleration."""
    if seed < 0 or samples < 2 or not min(dt, arias, duration, middle, frequency) > 0 or not 0 < damping_ratio < 1:
        raise InputError(
            "synthetic record",
            f"seed {seed}, {samples} samples at {dt:g} s, Arias intensity {arias:g} m/s, duration {duration:g} s, "
            f"middle of the shaking at {middle:g} s, frequency {frequency:g} Hz, bandwidth {damping_ratio:g}",
            "a seed of 0 or more, other numbers positive, and a bandwidth between 0 and 1",
        )
    rng = stream(seed, Purpose.RECORD)
    time = np.arange(samples) * dt
    filter_frequency = np.maximum(frequency + frequency_slope * (time - middle), 0.3)
    motion = modulating_function(time, arias, duration, middle) * filtered_noise(
        rng, samples, dt, filter_frequency, damping_ratio
    )
    # z″ + 2ω_c z′ + ω_c² z = x. The ground acceleration is z″; the ground velocity and displacement return to zero.
    corner = 2.0 * np.pi * CORNER_FREQUENCY
    numerator, denominator = scipy.signal.bilinear([1.0, 0.0, 0.0], [1.0, 2.0 * corner, corner**2], fs=1.0 / dt)
    acceleration: np.ndarray = scipy.signal.lfilter(numerator, denominator, motion)
    acceleration.setflags(write=False)
    return acceleration
