import csv

import numpy as np
import pytest

import structid as si
from structid.ground_motion import spectra


def flatfile(path, number):
    with path.open() as file:
        row = next(r for r in csv.DictReader(file) if r["RecId"] == number)
    keys = [k for k in row if k[0] == "T" and k.endswith("S") and k[1].isdigit()]
    return np.array([float(k[1:-1]) for k in keys]), np.array([float(row[k]) for k in keys]), float(row["PGA"])


def test_rotd50_of_rsn753_equals_peer_within_two_hundredths_of_a_percent(strong_motion):
    first = si.GroundMotion.read(strong_motion / "RSN753_LOMAP_CLS000.AT2")
    second = si.GroundMotion.read(strong_motion / "RSN753_LOMAP_CLS090.AT2")
    periods, expected, pga = flatfile(strong_motion / "peer_flatfile_subset.csv", "753")
    found = spectra.rotd_spectrum(first.values, second.values, first.dt, periods) / 9.80665
    error = np.abs(found / expected - 1.0)
    print(f"RotD50 of RSN 753 over {periods.size} periods: largest error {error.max():.2e}")
    assert periods.size > 100
    assert error.max() < 2e-4
    samples = min(len(first), len(second))
    assert spectra.rotd(first.values[:samples], second.values[:samples]) / 9.80665 == pytest.approx(pga, rel=2e-4)


def test_oscillator_at_a_period_equals_duhamel_for_a_linear_ramp():
    # a_g = −t from rest: u = t/ω² − sin(ωt)/ω³ (undamped), linear between samples, so the recurrence is exact.
    dt, period = 0.05, 0.7
    t = np.arange(200) * dt
    omega = 2 * np.pi / period
    found = spectra.oscillator_displacement(-t, dt, period, damping_ratio=0.0)
    np.testing.assert_allclose(found, t / omega**2 - np.sin(omega * t) / omega**3, atol=1e-11)


def test_start_from_rest_under_a_jump():
    # a_g = −1 from the first sample: u = (1 − cos ωt)/ω².
    dt, period = 0.05, 3.0
    t = np.arange(300) * dt
    omega = 2 * np.pi / period
    found = spectra.oscillator_displacement(-np.ones(300), dt, period, damping_ratio=0.0)
    np.testing.assert_allclose(found, (1 - np.cos(omega * t)) / omega**2, atol=1e-10)


def test_stiff_oscillator_feels_the_ground(record):
    spectrum = record.response_spectrum(np.array([0.01]))
    assert spectrum.pseudo_acceleration[0] == pytest.approx(record.pga, rel=0.02)
