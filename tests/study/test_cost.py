"""What a study is said to cost: every part of it, by counts that hold within a factor of two."""

import re

import numpy as np
import pytest

import structid as si
from structid.inference.error_model_choice import CHOICE_SAMPLER, usual_error_models
from structid.study import cost
from structid.study.cost import Part, StudyCost, estimate
from structid.study.run import load
from structid.study.stages.error_model_stage import FOR_CORRELATED_ERRORS, WITH_HIDDEN_VALUES, sampler_under
from studies import PLAIN, SMALL

AUTO = SMALL.replace('kind = "iid"', 'kind = "auto"')


def written(folder, text):
    (folder / "study.toml").write_text(text)
    return load(folder / "study.toml")


def without_sampler(text):
    return re.sub(r"\[sampler\].*?(?=\[deterministic\])", "", text, flags=re.DOTALL)


def evaluations(posterior, sampler):
    """Densities that a run evaluates."""
    count = 0
    parts = type(posterior).evaluate_parts

    def counted(phi):
        nonlocal count
        count += len(phi)
        return parts(posterior, phi)

    posterior.evaluate_parts = counted
    si.sample(posterior, sampler, seed=1)
    return count


@pytest.mark.slow
@pytest.mark.parametrize("law", [0, 1, 2])
@pytest.mark.parametrize("sampler", [CHOICE_SAMPLER, si.SMC(particles=200, steps=20)])
def test_a_tempering_takes_about_as_many_densities_as_it_says(tmp_path, law, sampler):
    posterior = written(tmp_path, SMALL).posterior
    posterior = posterior.on(error_model=usual_error_models(posterior.model)[law])
    ratio = sampler.evaluations(posterior.dimension) / evaluations(posterior, sampler)
    print(ratio)
    assert 0.5 < ratio < 2.0, ratio


def test_all_parts_are_in_the_sum(tmp_path):
    cost = estimate(written(tmp_path, AUTO))
    said = str(cost)
    for part in (
        "Choosing the error model",
        "Pattern search",
        "Interior point",
        "Sampling",
        "figures and page",
        "Total",
    ):
        assert part in said
    assert cost.seconds == pytest.approx(sum(part.seconds for part in cost.parts))
    assert "If the data choose drifting parameters" in said
    assert "drift" not in str(estimate(written(tmp_path, SMALL)))


def test_what_an_unknown_clock_costs_is_said(tmp_path):
    prior = 'time_shift = { distribution = "normal", unit = "s", mean = 0, sd = 0.02 }'
    asked = SMALL.replace("[observation]\n", f"[observation]\n{prior}\n", 1)
    assert asked != SMALL and "a run takes about ten times as long" in str(estimate(written(tmp_path, asked)))
    assert "time_shift" not in str(estimate(written(tmp_path, SMALL)))


def test_a_campaign_without_a_measurement_costs_its_runs(tmp_path):
    """Nothing is sampled, and no error model is chosen."""
    study = written(tmp_path, AUTO[: AUTO.index("[observation]")] + '[campaign]\nruns = 30\nmethod = "sobol"\n')
    assert study.posterior is None
    cost = estimate(study)
    assert [part.what for part in cost.parts] == ["Campaign"] and cost.parts[0].runs == 30


def test_parts_are_said_in_words():
    study_cost = StudyCost((Part("Campaign", 2.5, 1000, 50), Part("Predictions, figures and page", 200.0)), 50)
    assert str(study_cost).splitlines() == [
        "Campaign: 1,000 model runs in batches of 50, 2.5 ms per run: about 2 s",
        "Predictions, figures and page: about 3 min",
        "Total: about 3 min on this machine.",
    ]


def test_what_the_whole_budget_takes_is_said_beside_what_is_usual():
    parts = (Part("Campaign", 2.5, 1000),)
    plan = si.Plan(start=10, batch=10, true_runs=300)
    both = (
        "Total: about 2 s on this machine if 6 rounds are enough for the surrogate, 10 min if it needs all 26 rounds."
    )
    assert both in str(StudyCost(parts, 50, plan, longest=600.0))
    assert "if it needs" not in str(StudyCost(parts, 50, plan, longest=2.5))


def test_draws_of_a_start_and_discarded_draws_are_counted(tmp_path):
    study = written(tmp_path, PLAIN)
    sampling = (
        next(part for part in estimate(study).parts if part.what == "Sampling") if not study.has_surrogate else None
    )
    assert sampling is None or sampling.runs == study.sampler.steps * study.sampler.ensembles * study.sampler.walkers
    assert si.NUTS().evaluations(5) > 10 * 4 * 1500


def test_a_sampler_of_too_few_walkers_is_not_taken_for_values_at_knots(tmp_path):
    """Nor is it found out after the law has been chosen, for half a minute."""
    study = written(tmp_path, AUTO)
    laws = usual_error_models(study.model)
    drifting = study.posterior.on(error_model=next(law for law in laws if law.inside))
    assert study.sampler.walkers < 2 * drifting.dimension
    assert sampler_under(study, drifting) is WITH_HIDDEN_VALUES
    assert sampler_under(study, study.posterior) == study.sampler
    many = written(tmp_path, AUTO.replace("walkers = 12", "walkers = 100"))
    assert sampler_under(many, drifting) == many.sampler
    none = written(tmp_path, without_sampler(AUTO))
    assert sampler_under(none, drifting) is WITH_HIDDEN_VALUES
    as_it_comes = written(tmp_path, without_sampler(AUTO) + '\n[sampler]\nkind = "smc"\n')
    assert sampler_under(as_it_comes, drifting) is WITH_HIDDEN_VALUES
    assert sampler_under(as_it_comes, study.posterior) == si.SMC()
    assert sampler_under(none, study.posterior.on(error_model=laws[2])) is FOR_CORRELATED_ERRORS
    assert sampler_under(none, study.posterior) == none.sampler
    assert np.isfinite(estimate(none).otherwise.seconds)


def test_a_long_sampling_offers_a_small_population():
    sampling = Part("Sampling", 3600.0, 4_000_000, 2000)
    smaller = cost._with_a_small_population(si.SMC(), 12, [sampling])
    ratio = cost.SMALL_POPULATION.evaluations(12) / si.SMC().evaluations(12)
    assert smaller == pytest.approx(3600.0 * ratio) and smaller < 600.0
    assert "particles = 200, ensembles = 2" in StudyCost((sampling,), 2000, smaller=smaller).conclusion
    assert cost._with_a_small_population(si.SMC(), 12, [Part("Sampling", 60.0, 1000, 2000)]) is None
    assert cost._with_a_small_population(si.AIES(), 12, [sampling]) is None
    assert cost._with_a_small_population(cost.SMALL_POPULATION, 12, [sampling]) is None
