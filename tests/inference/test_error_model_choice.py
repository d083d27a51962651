"""The error model that the evidence prefers: that of the noise where the model is right, a drift where it is wrong."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.inference.error_model_choice import ErrorModelChoice, usual_error_models

SPACE = si.ParameterSpace(
    stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
)
LAW = dict(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06)
MODEL = si.BoucWen(**LAW, free=SPACE.names, substeps=1)
RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(1.8)
SAMPLER = si.SMC(particles=150, steps=15, ensembles=2, effective_share=0.5, correlation=0.5)


def measured(noise, **degradation):
    truth = si.BoucWen(**LAW, stiffness=7.2e6, gamma_ratio=0.4, **degradation, substeps=1)
    clean = truth.simulate(np.zeros((1, 0)), RECORD).values[0, :, 0]
    return si.Observation(RECORD, clean + noise(clean))


def white(clean, seed=1):
    return 0.02 * clean.std() * np.random.default_rng(seed).normal(size=clean.shape)


def correlated(clean):
    law = si.AR1(variance=float(0.05 * clean.std()) ** 2, white=0.0, correlation_time=0.1)
    return law.draw(np.random.default_rng(2), (1, len(clean), 1), {}, ("velocity",), RECORD.dt)[0, :, 0]


CASES = {
    "right model, white noise": (dict(noise=white), {"iid"}),
    "right model, AR(1) noise": (dict(noise=correlated), {"ar1"}),
    "a model that should degrade": (
        dict(noise=white, delta_nu=1.0, delta_eta=3.0),
        {"drifting parameters + iid", "drifting parameters + damped cosine"},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_the_right_error_model_is_chosen(case):
    given, right = CASES[case]
    choice = si.choose_error_model(SPACE, MODEL, measured(**given), sampler=SAMPLER, seed=1)
    assert choice.laws[choice.chosen] in right, str(choice)
    assert ("parameters drift" in choice.sentence) is ("drifting" in choice.laws[choice.chosen])


def test_a_choice_reports_its_margin():
    told = []
    choice = si.choose_error_model(
        SPACE,
        MODEL,
        measured(white, delta_nu=1.0, delta_eta=3.0),
        [si.IID(), si.Drifting()],
        sampler=SAMPLER,
        seed=1,
        progress=lambda *done: told.append(done),
    )
    assert choice.laws == ("iid", "drifting parameters + iid") and choice.chosen == 1
    assert choice.posterior.error_model.describe()["kind"] == "drifting" and choice.result is choice.results[1]
    assert "The data choose drifting parameters + iid" in choice.sentence and "nats ahead of iid" in choice.sentence
    assert "stiffness by" in choice.sentence and "kN/mm (" in choice.sentence and "% of its mean" in choice.sentence
    assert str(choice).count("±") == 3  # of both, and of what is between them
    assert told[-1] == (100, 100) and told == sorted(told)


def test_the_simplest_of_equals_is_chosen():
    observation = measured(white)
    one = si.choose_error_model(SPACE, MODEL, observation, [si.IID()], sampler=SAMPLER, seed=1).results[0]
    other = si.choose_error_model(SPACE, MODEL, observation, [si.IID()], sampler=SAMPLER, seed=2).results[0]
    for results in ((one, other), (other, one)):
        gap = abs(one.log_evidence.value - other.log_evidence.value)
        assert gap <= 2.0 * np.hypot(one.log_evidence.error, other.log_evidence.error)
        between = results[0].log_evidence - results[1].log_evidence
        assert abs(between.value) == gap and f"± {between.error:.2f}" in str(between)
        assert ErrorModelChoice(results).chosen == 0
    worse = results[0] if results[0].log_evidence.value < results[1].log_evidence.value else results[1]
    better = results[1] if worse is results[0] else results[0]
    assert (
        "simpler than iid and has the same evidence within the standard errors"
        in ErrorModelChoice((worse, better)).sentence
    )


def test_only_a_loop_over_time_can_drift():
    assert len(usual_error_models(MODEL)) == 5
    external = si.CallableModel(lambda parameters, record: record.values, SPACE.names, ("velocity",))
    assert len(usual_error_models(external)) == 3 and not external.can_drift


def test_what_cannot_be_chosen_is_refused():
    with pytest.raises(InputError, match="one or more"):
        si.choose_error_model(SPACE, MODEL, measured(white), [])


def test_earlier_names_work_with_a_warning():
    with pytest.warns(DeprecationWarning, match=r"choose_error_model\(laws=…\) is now called"):
        choice = si.choose_error_model(SPACE, MODEL, measured(white), laws=[si.IID()], sampler=SAMPLER, seed=1)
    with pytest.warns(DeprecationWarning, match="ErrorModelChoice.laws is now called ErrorModelChoice.error_models"):
        assert choice.laws == choice.error_models == ("iid",)
    with pytest.warns(DeprecationWarning, match="structid.choose_law is now called structid.choose_error_model"):
        assert si.choose_law is si.choose_error_model
    with pytest.warns(DeprecationWarning, match="Posterior.law"):
        assert choice.posterior.law is choice.posterior.error_model
