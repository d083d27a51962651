"""Evidence for a parameter from draws: closed forms of normal and exponential posteriors."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from law_paths import path_between
from structid.law_choice.law_comparison import LawComparison
from structid.law_choice.savage_dickey import log_evidence_by_draws

COUNT = 40_000


@pytest.mark.parametrize("distance", [0.0, 1.0, 2.0])
def test_a_normal_posterior_gives_its_bayes_factor(distance):
    """Prior N(0, 1), one value y with the error s: posterior N(y/(1 + s²), s²/(1 + s²)), neutral value zero."""
    error = 0.2
    sd = error / np.sqrt(1.0 + error**2)
    draws = sd * (distance + np.random.default_rng(0).normal(size=COUNT))
    log_ratio = scipy.stats.norm.logpdf(0.0) - scipy.stats.norm.logpdf(0.0, distance * sd, sd)
    # A tenth of the draws counts: 1/√4000 is 0.02; the curvature of the log density over the window adds 0.1 at two sd.
    assert log_evidence_by_draws(si.Normal(0.0, 1.0), draws, 0.0) == pytest.approx(log_ratio, abs=0.15)


@pytest.mark.parametrize("rate", [0.5, 5.0, 40.0])
def test_a_posterior_at_the_end_of_its_prior_gives_its_bayes_factor(rate):
    """Uniform prior on [0, 1], posterior ∝ e^(−kφ), neutral value zero: log Z/Z₀ = −log k/(1 − e^(−k))."""
    probability = np.random.default_rng(1).random(COUNT)
    draws = -np.log1p(-probability * -np.expm1(-rate)) / rate
    expected = -np.log(rate / -np.expm1(-rate))
    assert log_evidence_by_draws(si.Uniform(0.0, 1.0), draws, 0.0) == pytest.approx(expected, abs=0.06)


def test_the_limit_of_a_prior_without_an_end_is_neutral():
    prior = si.LogNormal(1.0, 0.5)
    draws = prior.quantile(np.random.default_rng(2).random(COUNT))  # the data say nothing
    for neutral in (0.0, np.inf):
        assert log_evidence_by_draws(prior, draws, neutral) == pytest.approx(0.0, abs=0.06)


def test_draws_that_do_not_reach_the_neutral_value_give_nothing():
    draws = 0.2 * (8.0 + np.random.default_rng(3).normal(size=COUNT))
    assert log_evidence_by_draws(si.Normal(0.0, 1.0), draws, 0.0) is None
    assert log_evidence_by_draws(si.Uniform(0.1, 1.0), np.linspace(0.1, 1.0, COUNT), 0.0) is None  # outside the prior


def test_draws_and_refits_give_the_same_evidence_for_a_mechanism():
    """The asymmetry of a symmetric specimen: its posterior is nearly normal, and Laplace's approximation holds."""
    path = path_between(5e-3 * np.array([1, -1, 2, -2, 3, -3, 4, -4]), 30)
    force = si.Hysteretic("bilinear", {"stiffness": 20e6, "yield_force": 60e3, "hardening": 0.1})
    values = force.simulate(np.zeros((1, 0)), si.DisplacementHistory(path, 1.0)).values[0, :, 0]
    noisy = values + 2e3 * np.random.default_rng(4).normal(size=len(path))
    choice = si.choose_model(si.CyclicTest(path, noisy), ["bilinear"], seed=1)
    compared = LawComparison(choice.test, choice.candidates, choice.dropped, choice.chosen)
    by_draws, by_refits = (c.mechanisms["asymmetric strength"] for c in (choice, compared))
    assert by_draws < -1.0
    assert by_draws != by_refits
    assert by_draws == pytest.approx(by_refits, abs=0.3)
    assert choice.mechanisms["hardening"] == compared.mechanisms["hardening"] > 5.0  # no draw comes near zero
