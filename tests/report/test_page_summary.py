"""The first screen of a report: the parameters as they may be used, whether to believe them, what is left open, what to do."""

from types import SimpleNamespace

import numpy as np
import pytest

import structid as si
from structid.core.by_type import ByType
from structid.inference.diagnostics.prior_warnings import prior_warnings
from structid.report.page_summary import comparison_summary, page_summary
from structid.surrogates.base import Surrogate

SPACE = si.ParameterSpace(
    stiffness=si.Uniform(5.0, 9.0, unit="kN/mm"), alpha=si.Uniform(0.0, 0.2), beta=si.Uniform(50.0, 70.0, unit="1/m")
)


def material(
    draws=None,
    elsewhere=None,
    truth=None,
    converged=True,
    wrong_model=(),
    wrong_error_model=(),
    against_priors=(),
    certificate=None,
    surrogate=None,
    cost=None,
    another_size=False,
):
    """What a calibration leaves, as far as the first screen looks at it; numbers in display units."""
    rng = np.random.default_rng(1)
    if draws is None:
        draws = rng.normal([7.6, 0.1, 61.0], [0.05, 0.005, 0.2], (4000, 3))
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    columns = {"mean": draws.mean(axis=0), "sd": draws.std(axis=0), "q05": low, "q95": high}
    if elsewhere is not None:
        columns["sd_elsewhere"] = np.array(elsewhere)
    verdict = SimpleNamespace(
        converged=converged,
        wrong_model=wrong_model,
        wrong_error_model=wrong_error_model,
        against_priors=against_priors,
        unexplained=0.01,
        another_size=another_size,
    )
    return SimpleNamespace(
        result=SimpleNamespace(verdict=lambda: verdict, cost=cost),
        calibration=None
        if certificate is None
        else SimpleNamespace(certificate=certificate, enough_to_go_on=400, hint=""),
        results=ByType({Surrogate: surrogate}),
        posterior=SimpleNamespace(space=SPACE, model_space=SPACE, names=SPACE.names, factors=SPACE.factors),
        summary=SimpleNamespace(names=SPACE.names, units=tuple(SPACE.units.values()), columns=columns),
        true_values={} if truth is None else dict(zip(SPACE.names, np.array(truth) * SPACE.factors, strict=True)),
        weighted_draws=(draws * SPACE.factors, None),
        other_records=(),
    )


def certificate(verdict):
    return SimpleNamespace(
        certified=verdict == "certified",
        usable=verdict != "not",
        true_runs=90,
        mean_bound=np.array([0.05]),
        verdict=verdict,
    )


def test_all_is_well():
    found = page_summary(material(truth=(7.6, 0.1, 61.3), certificate=certificate("certified")))
    assert found.trust == "good" and not found.wrong and found.truths == (3, 3)
    assert [b.about for b in found.believed] == ["Sampling", "Surrogate", "Model"]
    assert "90 model runs" in found.believed[1].said and "0.05 standard deviations" in found.believed[1].said
    assert found.unsaid == ["None: the data constrain every parameter separately."]
    assert found.further[0].startswith("Use the result") and "7.6" in str(found) and "✓ Model" in str(found)
    stiffness = found.parameters[0]
    # A uniform prior's 90 % interval is 3.6 kN/mm wide, and the posterior's 3.29 standard deviations of 0.05.
    assert stiffness.narrowed == pytest.approx(3.6 / (3.29 * 0.05), rel=0.05) and stiffness.narrowing == "22 times"
    assert 0.0 == stiffness.bar["prior_low"] < stiffness.bar["interval_low"] < stiffness.bar["truth"] < 100.0


def test_draws_that_have_not_converged_come_first_and_alone():
    found = page_summary(material(converged=False))
    assert found.trust == "bad" and found.unsaid == [] and len(found.further) == 1 and "--resume" in found.further[0]
    assert "do not use" in found.believed[0].said and [b.about for b in found.believed] == ["Sampling"]


@pytest.mark.parametrize(
    ("given", "trust", "said", "further"),
    [
        ({"certificate": certificate("usable with re-weighting")}, "doubtful", "re-weighting", "Use the result"),
        ({"certificate": certificate("not")}, "bad", "do not use", "true_runs = 400"),
        ({"certificate": certificate("not"), "cost": object()}, "good", "the model itself accepted", "Use the result"),
        ({"surrogate": object()}, "doubtful", "not certified", "Use the result"),
    ],
)
def test_a_surrogate_is_judged_by_itself(given, trust, said, further):
    found = page_summary(material(**given))
    assert found.trust == trust and said in found.believed[1].said and further in found.further[0]


def test_a_wrong_model_has_intervals_for_another_record():
    found = page_summary(material(elsewhere=(0.5, 0.006, 0.19), truth=(8.2, 0.1, 61.0), wrong_model=("It drifts.",)))
    assert found.wrong and found.elsewhere and found.trust == "bad"
    stiffness, alpha, beta = found.parameters
    assert stiffness.honest[1] > 8.2 > stiffness.interval[1] and stiffness.holds_truth
    assert alpha.elsewhere is not None and beta.elsewhere is None and beta.honest == beta.interval
    assert "Do not use these parameters" in found.further[0] and "another record" in found.further[1]
    assert "for another record" in str(found)


def test_units_come_before_the_model():
    found = page_summary(material(wrong_model=("It has 0.001 times the measured peak.",), another_size=True))
    assert "Check the units" in found.further[0] and not any("missing behaviour" in said for said in found.further)


def test_an_interval_for_another_record_stays_inside_the_prior():
    far = page_summary(material(elsewhere=(2.0, 0.3, 0.2), wrong_model=("It drifts.",)))
    assert far.parameters[0].honest == (5.0, 9.0) and far.parameters[1].honest[0] == 0.0


def test_what_the_data_do_not_say():
    rng = np.random.default_rng(2)
    one, other = rng.normal(size=4000), rng.normal(size=4000)
    draws = np.stack([7.6 + 0.05 * one, rng.uniform(0.0, 0.2, 4000), 61.0 + 0.2 * (0.98 * one + 0.2 * other)], axis=1)
    found = page_summary(material(draws))
    assert found.unsaid[0] == "The data hardly constrain α: its posterior is close to the prior."
    assert "stiffness and β" in found.unsaid[1] and "correlation 0.98" in found.unsaid[1]
    assert found.parameters[1].narrowing == "hardly" and any(
        "measure another channel" in said for said in found.further
    )


def test_a_law_that_is_wrong_is_a_doubt():
    found = page_summary(material(wrong_error_model=("the residuals are correlated",)))
    assert found.trust == "doubtful" and "discrepancy" in found.further[0]


def test_a_prior_that_the_data_contradict_comes_first():
    rng = np.random.default_rng(3)
    draws = rng.normal([7.6, 0.6, 50.0], [0.05, 0.06, 0.2], (4000, 3))
    draws[:, 2] = 50.0 + np.abs(draws[:, 2] - 50.0)
    space = si.ParameterSpace(
        stiffness=si.Uniform(5.0, 9.0, unit="kN/mm"),
        alpha=si.Normal(0.1, 0.05),
        beta=si.Uniform(50.0, 70.0, unit="1/m"),
    )
    against = tuple(prior_warnings(space, draws * space.factors))
    found = page_summary(material(draws, against_priors=against, wrong_model=("It drifts.",)))
    assert (
        found.further[0].startswith("The posterior of alpha lies in the far tail") and "the units" in found.further[0]
    )
    assert found.further[1].startswith("The posterior of beta lies at the lower bound") and "Widen" in found.further[1]
    assert "Do not use" in found.further[2]
    # As wide as its prior, and far from it: the data say a lot.
    assert not any("hardly constrain" in said for said in found.unsaid)


def test_what_drifts_as_far_as_its_prior_is_not_known_on_another_record():
    found = page_summary(material(elsewhere=(0.2, 0.005, 6.0), wrong_model=("It drifts.",)))
    said = [said for said in found.unsaid if "another record" in said]
    assert len(said) == 1 and "β" in said[0] and "stiffness" not in said[0] and "it drifts" in said[0]
    assert not any("another record" in said for said in page_summary(material(elsewhere=(0.2, 0.005, 0.2))).unsaid)


def test_the_best_prediction_may_be_worse_than_none():
    given = material()
    given.result.verdict().unexplained = 1.3
    assert "leaves 130 % of the measured variance unexplained" in page_summary(given).believed[-1].said


def compared(*classes):
    every = [
        SimpleNamespace(name=name, material=of, figures=SimpleNamespace(trusted=trusted))
        for name, of, trusted in classes
    ]
    return SimpleNamespace(classes=every, best=every[-1])


def test_a_comparison_says_which_to_use_and_when_none_is_right():
    wrong, right = material(wrong_model=("It drifts.",)), material()
    believed, further = comparison_summary(compared(("plain", wrong, True), ("degrading", right, True)))
    assert [b.trust for b in believed] == ["bad", "good"] and further[0].startswith("Use degrading")
    _, further = comparison_summary(compared(("plain", wrong, True), ("other", wrong, True)))
    assert "still wrong" in further[0]
    believed, further = comparison_summary(compared(("plain", right, False), ("degrading", right, True)))
    assert "do not trust its numbers" in believed[0].said and further == [
        "Finish plain first: structid run … --resume. Until then, the ranking may change."
    ]
