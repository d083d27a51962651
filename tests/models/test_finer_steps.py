"""A stronger motion than the measured one: runs that need shorter steps get them."""

import numpy as np

import structid as si
from structid.models.finer_steps import in_finer_steps, simulate_in_steps_it_needs

RECORD = si.GroundMotion.synthetic(seed=8, dt=0.02).trim(3.0, 9.0)
SHARP = si.Hysteretic(
    "bouc_wen",
    {"stiffness": "7 kN/mm", "yield_force": "30 kN", "exponent": 12.0},
    mass=12e3,
    damping_ratio=0.02,
    free=("hardening",),
    channels=("displacement",),
    substeps=1,
)
THETA = np.array([[0.1], [0.9]])


def test_runs_that_fail_in_long_steps_are_repeated_in_shorter_ones():
    strong = RECORD.scale(1.0)
    plain = SHARP.simulate(THETA, strong)
    assert not plain.done[0]
    runs = simulate_in_steps_it_needs(SHARP, THETA, strong)
    assert runs.done.all()
    assert runs.reasons == ("", "")
    exact = in_finer_steps(SHARP, 64).simulate(THETA, strong)
    np.testing.assert_allclose(runs.values, exact.values, atol=0.02 * np.abs(exact.values).max())


def test_runs_that_succeed_are_not_touched():
    weak = RECORD.scale(0.05)
    assert SHARP.simulate(THETA, weak).done.all()
    np.testing.assert_array_equal(
        simulate_in_steps_it_needs(SHARP, THETA, weak).values, SHARP.simulate(THETA, weak).values
    )
