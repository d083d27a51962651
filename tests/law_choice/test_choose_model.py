"""The choice of a law: fits from many starts, evidence beside long tempering runs, the right law of virtual tests."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from law_paths import path_between
from structid.inference.error_models.independent import IID
from structid.inference.error_models.kernels import AR1
from structid.law_choice.fit_store import FitStore
from structid.law_choice.law_comparison import chosen_candidate, compare_laws
from structid.law_choice.law_fit import LawFit, refine_law, search_law, without_mechanism
from structid.mechanics.hysteretic_laws.law_list import law_of
from structid.optimize.many_starts import minima_from_many_starts, refined

ENDS = 1e-3 * np.array([2, -2, 4, -4, 4, -4, 8, -8, 8, -8, 12, -12, 12, -12, 16, -16, 16, -16])
PATH = path_between(ENDS, 24)
NOISE = 0.02


def virtual(word, seed=0, correlation=0.0, noise=NOISE, **values):
    """A test of a specimen that is a law, with noise relative to the largest force."""
    common = {"stiffness": "20 kN/mm", "yield_force": "60 kN"}
    model = si.Hysteretic(word, common | values, force_offset=2e3)
    force = model.simulate(np.zeros((1, 0)), si.DisplacementHistory(PATH, 1.0)).values[0, :, 0]
    errors = np.random.default_rng(seed).normal(size=len(PATH)) * noise * np.abs(force).max()
    for k in range(1, len(errors)):
        errors[k] = correlation * errors[k - 1] + np.sqrt(1.0 - correlation**2) * errors[k]
    return si.CyclicTest(PATH, force + errors, word)


def fitted(test, law, errors):
    """A law fitted to a test."""
    [fit] = refine_law(test, law, search_law(test, law, 1), [errors])
    return fit


def test_the_lowest_of_many_minima_is_found():
    """Residuals with minima near every second number from 0.5 on; the one at 0.5 is the lowest."""

    def residuals(x):
        well = 1.2 - np.cos(np.pi * (x[:, :1] - 0.5)) + 0.1 * (x[:, :1] - 0.5) ** 2
        return np.concatenate([well, 0.5 * (x[:, 1:] - 1.0)] * 40, axis=1)

    minima = minima_from_many_starts(residuals, 2, np.random.default_rng(1))
    assert minima[0].x == pytest.approx([0.5, 1.0], abs=0.05)
    assert minima[-1].value >= minima[0].value
    assert minima[0].mean_squares[0] == pytest.approx(0.5 * 0.2**2, rel=0.05)


def test_a_curvature_that_hides_the_prior_in_round_off_has_draws():
    """The data determine one direction 1e18 times as well as the prior does."""
    fit = fitted(virtual("bilinear", hardening=0.1), law_of("test", "bilinear"), IID())
    direction = np.random.default_rng(0).normal(size=len(fit.minimum.x))
    steep = 1e18 * np.outer(direction, direction) + np.eye(len(direction))
    assert np.linalg.eigvalsh(steep)[0] < 0.5
    steep_fit = replace(fit, minimum=replace(fit.minimum, curvature=steep))
    forces = steep_fit.forces(steep_fit.normal_draws(20, np.random.default_rng(0)), fit.test)
    assert len(forces) and np.isfinite(forces).all()
    assert np.isfinite(steep_fit.log_evidence)
    assert np.isfinite(steep_fit.sampled(1).history).all()


@pytest.mark.parametrize(("errors", "within"), [(IID(), 0.5), (AR1(white=0.0), 2.0)])
def test_laplace_is_the_evidence_of_a_linear_model(errors, within):
    """The density is normal in the parameters, and nearly so in log σ²; the correlation of independent errors lies at an edge."""
    test = linear_test()
    fit = fitted(test, law_of("test", "linear"), errors)
    tempered = fit.sampled(1)
    assert tempered.verdict().converged
    assert abs(fit.log_evidence - tempered.log_evidence.value) < within
    assert fit.best[0] == pytest.approx(20e6, rel=0.01)


def test_the_evidence_of_correlated_errors_is_that_of_a_long_run():
    """σ² and the correlation time vary together along a ridge that is far longer than it is wide."""
    test = virtual("bilinear", hardening=0.05, correlation=0.97)
    fit = fitted(test, law_of("test", "bilinear"), AR1(white=0.0))
    tempered = fit.sampled(1)
    assert tempered.verdict().converged
    assert abs(fit.log_evidence - tempered.log_evidence.value) < 1.5


def linear_test():
    """A test of an elastic specimen."""
    force = 20e6 * PATH + 2e3
    noise = np.random.default_rng(0).normal(size=len(PATH)) * NOISE * np.abs(force).max()
    return si.CyclicTest(PATH, force + noise)


def test_errors_with_a_correlation_are_recognised():
    law = law_of("test", "bilinear")
    test = virtual("bilinear", hardening=0.05, correlation=0.7)
    independent, correlated = (fitted(test, law, errors) for errors in (IID(), AR1(white=0.0)))
    assert correlated.correlations[0] == pytest.approx(0.7, abs=0.12)
    assert correlated.log_evidence > independent.log_evidence + 50.0


def test_a_mechanism_is_found_where_it_is_and_not_where_it_is_not():
    law = law_of("test", "bilinear")
    for hardening, shown in ((0.05, True), (0.0, False)):
        test = virtual("bilinear", hardening=hardening)
        fit = fitted(test, law, IID())
        gain = fit.log_evidence - without_mechanism(fit, "hardening").log_evidence
        assert (gain > 5.0) == shown


def test_a_wrong_law_leaves_an_error_of_its_own():
    """Correlated errors account for it, so that no test of the whitened residuals speaks against this law."""
    right, wrong = compared_alone("bilinear", AR1(white=0.0)), compared_alone("elastic_plastic", AR1(white=0.0))
    assert right.chosen.fit.leaves_noise and "What it leaves is noise." in right.sentence
    assert not wrong.chosen.fit.leaves_noise and "correlated from sample to sample" in wrong.sentence


def test_a_law_that_leaves_noise_is_chosen_though_another_predicts_better():
    right, wrong = compared_alone("bilinear", IID()).chosen, compared_alone("elastic_plastic", IID()).chosen
    # As if the first part of the test did not show the hardening
    right.__dict__["prediction_error"] = 3.0 * wrong.prediction_error
    assert chosen_candidate([right, wrong]) is right
    right.fit.__dict__["residual_correlation"] = 0.9
    assert chosen_candidate([right, wrong]) is wrong


def test_draws_decide_between_laws_of_close_evidence(monkeypatch, tmp_path):
    """As if Laplace's approximation were 60 nats wrong for the bilinear spring of an elastic–plastic specimen."""
    test, laws = virtual("elastic_plastic"), ("elastic_plastic", "bilinear")
    right = si.choose_model(test, laws, [IID()], seed=1)
    assert right.chosen.law.word == "elastic_plastic"
    laplace = LawFit.log_evidence.func

    def wrong(fit):
        return laplace(fit) + (60.0 if fit.law.word == "bilinear" else 0.0)

    monkeypatch.setattr(LawFit, "log_evidence", property(wrong))
    deceived = si.choose_model(test, laws, [IID()], seed=1)
    assert deceived.chosen.law.word == "bilinear"
    monkeypatch.setattr("structid.law_choice.law_comparison.CLOSE", 100.0)
    for _ in range(2):  # the second time from the stored draws
        choice = si.choose_model(test, laws, [IID()], seed=1, folder=tmp_path)
        assert choice.chosen.law.word == "elastic_plastic"
        assert list(choice.rival_results) == ["bilinear"]
        behind = choice.result.log_evidence.value - choice.rival_results["bilinear"].log_evidence.value
        assert f"bilinear spring with kinematic hardening is {behind:.1f} ±" in choice.sentence
    assert (tmp_path / "chains_elastic_plastic.0.h5").exists()


def compared_alone(law, errors, noise=NOISE):
    """One law on a test of a bilinear specimen."""
    test = virtual("bilinear", noise=noise, hardening=0.05)
    return compare_laws(test, [law_of("test", law)], [errors], 1, FitStore(None, {}))


def test_a_law_that_explains_nearly_all_does_not_explain_100_percent():
    assert "explains 99." in compared_alone("bilinear", IID()).sentence
    assert "explains all but 0.0" in compared_alone("bilinear", IID(), 0.1 * NOISE).sentence


def test_searches_from_one_valley_end_early_and_give_one_minimum():
    """Ten searches reach the minimum of a quadratic form within a few steps."""
    runs = []

    def residuals(x):
        runs.append(len(x))
        slopes = np.stack([np.linspace(1.0, 2.0, 60), np.sin(np.arange(60.0))])
        return 1.0 + 0.1 * np.cos(np.arange(60.0)) - x @ slopes

    starts = np.random.default_rng(0).normal(size=(10, 2))
    (minimum,) = refined(residuals, starts, 30)
    assert len(runs) < 2 * 15
    further = refined(residuals, minimum.x[None], 30)[0]
    assert minimum.value - further.value < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("word", "values", "allowed"),
    [
        ("bilinear", {"hardening": 0.05}, {"bilinear"}),
        ("self_centering", {"hardening": 0.03, "flag_height": 0.7}, {"self_centering"}),
        ("pivot", {"hardening": 0.02, "primary": 4.0, "pinching": 0.4}, {"pivot"}),
        ("masing", {"sharpness": 1.2, "energy_damage": 0.02}, {"masing", "masing_flag"}),
    ],
)
def test_the_right_law_is_chosen(word, values, allowed):
    test = virtual(word, **values)
    laws = ("elastic_plastic", "bilinear", "self_centering", "masing", "masing_flag", "pivot")
    choice = si.choose_model(test, laws, seed=1)
    assert choice.chosen.law.word in allowed, str(choice)
    assert choice.least_squares < 2.0 * NOISE**2 / np.var(test.force / test.largest_force)
    assert choice.result.log_evidence.value == pytest.approx(choice.chosen.fit.log_evidence, abs=3.0)
    truth = dict(zip(choice.result.names, choice.result.flat.T, strict=True))["stiffness"]
    assert np.quantile(truth, 0.001) < 20e6 < np.quantile(truth, 0.999)
    assert choice.sentence.startswith("The test chooses")
    assert "What it leaves is noise." in choice.sentence
