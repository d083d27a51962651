"""Filters and resampling invent nothing at the ends of a signal: against the same filter of a signal that goes on."""

import numpy as np
import pytest

from structid.ground_motion.processing import butterworth, resample

DT, SAMPLES = 0.005, 2000
SIGNALS = {
    "constant": np.ones_like,
    "line": lambda t: t,
    "pulse": lambda t: np.exp(-(((t - 5.0) / 1.5) ** 2)) * np.sin(4.0 * np.pi * t),
    "sine": lambda t: np.sin(2.6 * np.pi * t),
    "cosine": lambda t: np.cos(2.6 * np.pi * t),
}
FILTERS = {"low": ("lowpass", 20.0), "high": ("highpass", 0.1), "band": ("bandpass", (0.1, 20.0))}
ERRORS = {"constant": 1e-9, "line": 1e-7, "pulse": 1e-5, "sine": 0.08, "cosine": 0.01}
"""Largest difference anywhere, of signals of size one (a line of 10). Where a signal is cut off in full motion, its ends must be
guessed: a sine's mean over the record is not zero, and a low-pass has no more than its slope."""


def exact(signal, band, edges):
    """The same filter of a signal that goes on for twenty lengths on either side."""
    time = np.arange(-20 * SAMPLES, 21 * SAMPLES) * DT
    return butterworth(SIGNALS[signal](time), DT, edges, band, 4)[20 * SAMPLES : 21 * SAMPLES]


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize("kind", FILTERS)
def test_a_filter_of_a_part_is_that_of_the_whole(kind, signal):
    band, edges = FILTERS[kind]
    found = butterworth(SIGNALS[signal](np.arange(SAMPLES) * DT), DT, edges, band, 4)
    error = np.abs(found - exact(signal, band, edges))
    assert error.max() < ERRORS[signal], error.max()
    if band == "lowpass":  # it forgets its ends within a tenth of a second
        assert error[50:-50].max() < 1e-6


@pytest.mark.parametrize(
    "steps", [(0.01, 0.005), (0.01, 0.02), (0.01, 1 / 256), (1 / 256, 0.005), (0.005, 0.02), (0.01, 0.0137)]
)
def test_resampling_keeps_constants_lines_and_ends(steps):
    dt, new = steps
    time = np.arange(801) * dt
    constant = resample(np.ones(801), dt, new)
    np.testing.assert_allclose(constant, 1.0, rtol=0, atol=1e-14)
    own = np.arange(constant.size) * new
    assert own[-1] <= time[-1] * (1.0 + 1e-12) and own[-1] + new > time[-1]
    np.testing.assert_allclose(resample(time, dt, new), own, rtol=0, atol=1e-4 * dt * 100)
    wave = resample(np.cos(2.6 * np.pi * time), dt, new)
    assert np.abs(wave - np.cos(2.6 * np.pi * own)).max() < 2e-3 and np.abs(wave).max() < 1.002


def test_the_same_step_is_the_same_signal():
    np.testing.assert_array_equal(resample(np.arange(5.0), 0.01, 0.01), np.arange(5.0))


def test_a_short_signal_is_resampled_too():
    np.testing.assert_allclose(resample(np.ones(2), 0.01, 0.0025), np.ones(5), atol=1e-14)


def test_a_step_from_rounded_times_is_as_good_as_the_exact_one():
    time = np.arange(4000) / 256.0
    exact_step, rounded = (resample(np.sin(time), dt, 0.005) for dt in (1 / 256, 0.00390625 * (1 + 1e-7)))
    np.testing.assert_array_equal(exact_step, rounded)
