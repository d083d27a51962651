"""The error model, left to the data: what a bad surrogate had to choose, since the budget was spent, is chosen again."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si

SPACE = si.ParameterSpace(
    stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
)
MODEL = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=SPACE.names)


@pytest.fixture(scope="module")
def measured():
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(2.0)
    y = MODEL.simulate(np.array([[7.2e6, 0.4]]), record).values[0, :, 0]
    return si.Observation(record, y + 0.05 * y.std() * np.random.default_rng(1).normal(size=y.shape))


def calibrated(measured, true_runs, store):
    explorer = si.SMC(particles=100, ensembles=4, steps=12, effective_share=0.5, correlation=0.5)
    plan, sampler = (
        si.Plan(true_runs=true_runs, exploration_sampler=explorer),
        replace(explorer, particles=200, steps=30),
    )
    return si.calibrate(MODEL, SPACE, measured, None, "auto", plan=plan, sampler=sampler, seed=1, store=store)


@pytest.mark.slow
def test_a_choice_for_want_of_runs_is_made_again(measured, tmp_path):
    short = calibrated(measured, 40, tmp_path)
    assert not short.certificate.certified
    found = calibrated(measured, 200, tmp_path)
    assert found.certificate.certified
    assert [e.value for e in found.error_model_choice.evidences] != [e.value for e in short.law_choice.evidences]
    assert found.error_model_choice.laws[found.law_choice.chosen] == "iid"
    again = calibrated(measured, 200, tmp_path)
    np.testing.assert_array_equal(again.sampling.draws, found.sampling.draws)
    assert [e.value for e in again.error_model_choice.evidences] == [e.value for e in found.law_choice.evidences]
