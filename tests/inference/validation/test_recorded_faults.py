"""What a measured history shows by itself is asked about, and a right one is not."""

import re

import numpy as np
import pytest

import structid as si
from structid.core.channels import standard_unit
from structid.core.errors import UnlikeMeasuredWarning
from structid.inference.validation.recorded_faults import clipped, gap, questions_of_the_measurement

DT = 0.01
RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(2.0, 22.0).pad(before=2.0, after=3.0).scale_to_pga(2.0)
MODEL = si.BoucWen(mass=12e3, stiffness=7.6e6, alpha=0.05, beta=63.0, gamma_ratio=1.0, damping_ratio=0.03)
CLEAN = MODEL.simulate(np.zeros((1, 0)), RECORD).values[0, :, 0]
PEAK = np.abs(CLEAN).max()
NOISY = CLEAN + 0.01 * PEAK * np.random.default_rng(0).standard_normal(CLEAN.shape)
COUNTED = np.round(NOISY / PEAK * 200.0) * PEAK / 200.0


def asked(values, **nuisances):
    observation = si.Observation(RECORD, values, **nuisances)
    return " ".join(questions_of_the_measurement(observation, {"velocity": standard_unit("velocity")}))


@pytest.mark.parametrize(
    "values",
    [CLEAN, NOISY, COUNTED, -3.0 * COUNTED],
    ids=["clean", "noisy", "counted", "turned"],
)
def test_a_right_history_is_not_asked_about(values):
    assert asked(values) == ""


def with_gap(values):
    moving = int(np.argmax(np.abs(values)))
    return np.where((np.arange(len(values)) - moving) // 150 == 0, 0.0, values)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            NOISY + 0.05 * PEAK,
            r"in the 2 s before the record begins, 5% of its peak\. Is it an offset of the instrument",
        ),
        (NOISY + 2.0 * PEAK, r"times its standard deviation\. Is it an offset"),
        (np.abs(COUNTED), r"times its standard deviation\. Is it an offset"),
        (np.full(len(CLEAN), 0.3), r"The measured velocity is 300 mm/s throughout\. Did the sensor fail"),
        (with_gap(NOISY), r"is exactly zero from [\d.]+ s to [\d.]+ s, next to large values"),
        (np.clip(NOISY, -0.7 * PEAK, 0.7 * PEAK), r"stays at its extreme value [-\d.]+ mm/s for up to \d+ samples"),
        (np.clip(COUNTED, -0.7 * PEAK, 0.7 * PEAK), "Was the instrument at the end of its range"),
        (RECORD.time, r"is a straight line from 0 to .* Is it the time column"),
        (np.round(RECORD.time, 3), "is a straight line"),
    ],
)
def test_what_is_asked_about(values, words):
    assert re.search(words, asked(values)), asked(values)


def test_zeros_are_asked_about_although_other_values_are_missing():
    zeros = with_gap(NOISY)
    missing = (np.arange(len(NOISY)) % 97 == 0) & (zeros != 0.0)
    assert "is exactly zero from" in asked(np.where(missing, np.nan, zeros))
    assert asked(np.where(missing, np.nan, NOISY)) == ""


def test_a_history_of_one_sign_is_not_clipped_at_its_zero():
    assert clipped("the force", np.abs(COUNTED), "kN") == ""


def test_a_displacement_may_stay_where_a_velocity_may_not():
    """A residual drift of a displacement moves its mean, and asks for nothing."""
    drifted = CLEAN / 10.0 + 0.5 * PEAK / 10.0 * np.linspace(0.0, 1.0, len(CLEAN)) ** 0.2
    drifted = np.where(RECORD.time < 2.0, 0.0, drifted)
    observation = si.Observation(RECORD, drifted, ("displacement",))
    assert questions_of_the_measurement(observation, {"displacement": standard_unit("displacement")}) == []
    assert "Is it an offset" in asked(drifted)


def test_an_offset_with_a_prior_is_known():
    assert asked(NOISY + 0.05 * PEAK, offset=si.Normal(0.0, 0.1 * PEAK)) == ""


def test_a_small_cut_is_seen_and_a_history_at_rest_is_not_cut():
    assert "extreme value" in clipped("measured force", np.clip(CLEAN, -0.9 * PEAK, 0.9 * PEAK), "mm/s")
    assert clipped("measured force", np.zeros(100), "kN") == ""


def test_a_pause_between_two_records_is_no_gap():
    quiet = np.exp(-(((np.arange(600) - 300) / 60.0) ** 2)) * np.sin(np.arange(600))
    two = np.concatenate([quiet, np.zeros(500), quiet])
    assert gap("record", two, DT) == ""
    assert "is exactly zero from 6" in gap("record", np.concatenate([quiet[:300], np.zeros(500), quiet[300:]]), 0.02)


def test_a_calibration_warns_of_it():
    space = si.ParameterSpace(stiffness=si.Normal(7.6e6, 0.3e6, low=6e6, high=9e6))
    model = si.BoucWen(mass=12e3, alpha=0.05, beta=63.0, gamma_ratio=1.0, damping_ratio=0.03, free=("stiffness",))
    with pytest.warns(UnlikeMeasuredWarning, match="before the record begins"):
        si.calibrate(model, space, si.Observation(RECORD, NOISY + 0.05 * PEAK), seed=1, true_runs=40)
