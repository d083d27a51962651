"""Model beside measurement: a unit, a sign, a clock that is wrong is asked for, and what is right is not."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import StructidWarning

PEAK, SAMPLES, DT = 0.02, 2000, 0.01
TIME = DT * np.arange(SAMPLES)
RECORD = si.GroundMotion(np.sin(TIME), DT, name="sine")
RESPONSE = PEAK * np.sin(2.0 * np.pi * 1.5 * TIME) * np.exp(-(((TIME - 8.0) / 3.0) ** 2))


def questions(modelled, measured, **nuisances):
    from structid.core.channels import standard_unit
    from structid.inference.validation.side_by_side import SideBySide

    observation = si.Observation(RECORD, measured, channels=("displacement",), **nuisances)
    (pair,) = SideBySide.of({"displacement": modelled}, {"displacement": standard_unit("displacement")}, observation)
    return " ".join(pair.questions.values())


@pytest.mark.parametrize("factor", [0.3, 1.0, 3.0])
def test_what_is_of_similar_size_is_not_asked_for(factor):
    assert questions(factor * RESPONSE, RESPONSE) == ""


@pytest.mark.parametrize(
    ("modelled", "said"),
    [
        (1e-3 * RESPONSE, "is 0.001 times the measured peak. Are all units right"),
        (9.81 * RESPONSE, "is 9.8 times the measured peak"),
        (-RESPONSE, "the sign reversed"),
        (np.roll(RESPONSE, 217), "moved 2.17 s ahead"),
        (PEAK * np.sin(2.0 * np.pi * 6.0 * TIME), "mainly at 6 Hz, the measured displacement at 1.5 Hz"),
    ],
)
def test_what_is_asked_for(modelled, said):
    assert said in questions(modelled, RESPONSE)


def test_a_gain_of_minus_one_is_no_reversed_sign():
    assert questions(-RESPONSE, RESPONSE, gain=si.Normal(-1.0, 0.05, high=0.0)) == ""
    assert "the sign reversed" in questions(RESPONSE, RESPONSE, gain=si.Normal(-1.0, 0.05, high=0.0))
    assert questions(-RESPONSE, RESPONSE, gain=si.Uniform(-2.0, 2.5)) == ""  # what the data are asked for
    assert questions(100.0 * RESPONSE, RESPONSE, gain=si.Normal(0.01, 0.001)) == ""


def test_a_higher_mode_and_a_drift_are_no_wrong_stiffness():
    second = 0.5 * PEAK * np.sin(2.0 * np.pi * 6.1 * TIME) * np.exp(-(((TIME - 8.0) / 3.0) ** 2))
    drift = 5.0 * PEAK / (1.0 + np.exp(8.0 - TIME))
    assert questions(RESPONSE + second, RESPONSE + 3.0 * second) == ""
    assert "mainly" not in questions(RESPONSE, RESPONSE + drift)
    assert "mainly" in questions(second, RESPONSE + drift)


@pytest.fixture(scope="module")
def measured():
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 7.0).scale_to_pga(2.0)
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=("stiffness", "gamma_ratio"))
    y = model.simulate(np.array([[7.2e6, 0.4]]), record).values[0, :, 0]
    return model, record, y + 0.05 * y.std() * np.random.default_rng(1).normal(size=y.shape)


def priors(stiffness):
    return si.ParameterSpace(
        stiffness=si.LogNormal(stiffness, 0.1 * stiffness, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
    )


@pytest.mark.parametrize(("stiffness", "scale"), [(740.0, 1.0), (7.4, 1e3)], ids=["prior", "measurement"])
def test_a_calibration_with_a_wrong_unit_asks_for_it(measured, stiffness, scale):
    """Every figure may be certified, since the surrogate is that of the model: only the units are wrong."""
    model, record, y = measured
    with pytest.warns(StructidWarning, match="times the measured peak. Are all units right"):
        found = si.calibrate(model, priors(stiffness), si.Observation(record, scale * y), seed=1, true_runs=60)
    verdict = found.verdict()
    assert verdict.another_size and "times the measured peak: check the units" in verdict.wrong_model[0]
    assert "damped_cosine" not in str(verdict)  # no error model mends a unit


def test_a_unit_so_wrong_that_no_run_finishes_is_asked_for(measured):
    model, record, y = measured
    with pytest.raises(si.StructidError, match=r"too long for the stiffness.*Check the units of the priors"):
        si.calibrate(model, priors(7400.0), si.Observation(record, y), seed=1, true_runs=60)


@pytest.mark.parametrize(
    ("unexplained", "peak", "asked"),
    [
        (1.0, 1e-3, True),
        (1e6, 1e3, True),
        (1.0, 0.0, True),
        (0.1, 0.9, False),
        (0.9, 0.5, False),
        (np.inf, np.nan, False),
    ],
)
def test_which_best_prediction_is_of_another_size(unexplained, peak, asked):
    """A run that failed has no size."""
    from structid.inference.prediction.best_prediction import BestPrediction

    assert BestPrediction(unexplained, peak).of_another_size is asked


def test_wide_priors_are_no_mistake(measured, recwarn):
    """Runs of half the prior are more than eight times too small: the others are not."""
    model, record, y = measured
    space = si.ParameterSpace(
        stiffness=si.LogNormal(log_mean=float(np.log(40.0)), log_sd=1.5, unit="kN/mm"),
        gamma_ratio=si.Uniform(-1.0, 1.0),
    )
    plan = si.Plan(
        true_runs=60, exploration_sampler=si.SMC(particles=80, steps=8, effective_share=0.5, correlation=0.5)
    )
    si.calibrate(model, space, si.Observation(record, y), plan=plan, sampler=plan.exploration_sampler, seed=1)
    assert not [
        w for w in recwarn if issubclass(w.category, StructidWarning) and "times the measured" in str(w.message)
    ]


def test_a_right_calibration_asks_for_nothing(measured, recwarn, tmp_path):
    xarray = pytest.importorskip("xarray")
    model, record, y = measured
    found = si.calibrate(model, priors(7.4), si.Observation(record, y), seed=1, true_runs=60)
    assert not [w for w in recwarn if issubclass(w.category, StructidWarning)]
    assert found.certified and not found.verdict().another_size and not found.verdict().wrong_model
    np.testing.assert_allclose(found.draws.reshape(-1, 3).mean(axis=0), found.mean, rtol=1e-12)
    with xarray.open_dataset(found.to_netcdf(tmp_path / "draws.nc", predictions=False), group="posterior") as stored:
        assert float(stored["stiffness"].mean()) == pytest.approx(found.mean[0], rel=1e-12)
