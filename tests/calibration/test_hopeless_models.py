"""A solver of which no run finishes: the first design says so, and no more is spent on it."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import CampaignStoppedError


def test_a_model_of_which_no_run_finishes_stops_after_the_first_design():
    asked = []

    def respond(parameters, record):
        asked.append(parameters)
        raise KeyError("k")

    space = si.ParameterSpace(stiffness=si.Normal(7.4, 0.7, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0))
    record = si.GroundMotion.synthetic(seed=3, duration=6.0)
    measured = si.Observation(record, np.sin(record.time))
    broken = si.CallableModel(respond, free=space.names, channels=("velocity",), isolated=False)
    with pytest.raises(CampaignStoppedError, match=r"None of the first 10 model runs.*KeyError"):
        si.calibrate(broken, space, measured, seed=1)
    assert len(asked) == 10


def test_a_model_with_noise_stops_after_the_first_design(tmp_path):
    """One repeated run finds it; a calibration of the same model without noise goes on, with that run in its count."""
    space = si.ParameterSpace(stiffness=si.Normal(7.4, 0.7, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0))
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(1.8)
    inside = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=space.names, substeps=1)
    clean = inside.simulate(np.array([[7.2e6, 0.4]]), record).values[0, :, 0]
    measured = si.Observation(record, clean + 0.02 * clean.std() * np.random.default_rng(1).normal(size=clean.shape))
    asked, rng = [], np.random.default_rng(2)

    def solver(noise):
        def respond(parameters, record):
            asked.append(parameters)
            values = inside.simulate(np.array([[parameters[name] for name in space.names]]), record).values[0, :, 0]
            return values + noise * clean.std() * rng.normal(size=values.shape)

        return si.CallableModel(respond, free=space.names, channels=("velocity",), isolated=False)

    noisy = solver(1e-3)
    for _ in range(2):  # the folder keeps the first design and the repeated run
        with pytest.raises(CampaignStoppedError, match=r"not deterministic: .* Fix its random seed"):
            si.calibrate(noisy, space, measured, seed=1, store=tmp_path / "noisy")
        assert len(asked) == 11
    asked.clear()
    plan = si.Plan(true_runs=60, exploration_sampler=si.SMC(particles=80, steps=8))
    found = si.calibrate(solver(0.0), space, measured, plan=plan, seed=1)
    assert len(asked) == found.certificate.true_runs <= 60
