"""How the error of a law grows beyond its data, what the laws weigh in a prediction, and which samples a band holds."""

from dataclasses import replace

import numpy as np
import pytest
from test_choose_model import PATH, virtual

import structid as si
from law_paths import path_between
from structid.law_choice import choose_model
from structid.law_choice.extrapolation import (
    TO_ALL,
    TO_FIRST_PART,
    Trial,
    distance_beyond,
    fitted_growth,
    weights_by_prediction,
)

LAWS = ("elastic_plastic", "bilinear")


@pytest.fixture(scope="module")
def choice():
    return si.choose_model(virtual("bilinear", hardening=0.1), LAWS, seed=1)


@pytest.fixture(scope="module")
def wrong():
    """A bilinear spring chosen for a specimen that pinches and loses strength."""
    values = {"sharpness": 1.2, "energy_damage": 0.04, "peak_damage": 0.03}
    return si.choose_model(virtual("masing", **values), LAWS, seed=1)


def test_the_distance_is_zero_within_the_data_and_a_logarithm_beyond():
    known = np.array([0.0, 1.0, -1.0, 0.0])  # largest 1, cumulative 4
    distance = distance_beyond(np.array([0.0, 1.0, 0.0, 2.0, -2.0]), known)
    np.testing.assert_allclose(distance[:3], 0.0)
    np.testing.assert_allclose(distance[3:], [[np.log(2.0), 0.0], [np.log(2.0), np.log(2.0)]])


def test_the_growth_of_the_error_is_what_the_parameters_do_not_explain():
    """Errors of sd² = (1 + 3 d)² + (4 d)², where 4 d comes from the parameters."""
    beyond = np.linspace(0.0, 1.0, 4000)
    spread = 4.0 * beyond
    error = np.hypot(1.0 + 3.0 * beyond, spread) * np.random.default_rng(0).normal(size=len(beyond))
    trial = Trial(np.stack([beyond, 0.0 * beyond], axis=1), error, spread, [], 1.0)
    growth = fitted_growth([trial], True)
    # Relative standard error of a scale from n values: 1/√(2n), here of values of which a half tells of the growth
    assert growth[0] == pytest.approx(3.0, rel=5.0 * np.sqrt(2.0 / len(beyond)))
    assert growth[1] == pytest.approx(1.0, rel=1e-3)  # no value tells of it: the median of its prior
    assert fitted_growth([trial], False)[0] > 3.7


def test_the_right_law_carries_the_prediction_and_its_band_holds_the_force(choice):
    assert choice.weights["bilinear"] > 0.95
    assert sum(choice.weights.values()) == pytest.approx(1.0)
    assert choice.held_out.coverage > 0.85
    error = (choice.held_out.mean - choice.test.force)[choice.held_out.start :]
    assert np.sqrt(np.mean(error**2)) < 0.03 * choice.test.largest_force


def test_the_band_of_a_wrong_law_grows_beyond_the_data(wrong):
    law = next(law for law in wrong.on_parts if law.word == "bilinear")
    assert (law.growth(TO_FIRST_PART) > 0.0).all()
    predictions = [wrong.predict(factor * PATH) for factor in (1.0, 3.0)]
    inside, beyond = (prediction.band() for prediction in predictions)
    widths = [np.mean(high - low) for low, high in (inside, beyond)]
    assert widths[1] > 1.3 * widths[0]
    assert wrong.held_out.coverage > 0.7
    # The errors within the data alone are too small a band.
    low, high = (wrong.held_out.mean + side * 1.645 * law.sd(TO_FIRST_PART) for side in (-1.0, 1.0))
    after = slice(wrong.held_out.start, None)
    held = np.mean(((wrong.test.force >= low) & (wrong.test.force <= high))[after])
    assert held < wrong.held_out.coverage


def test_the_energy_and_the_largest_force_of_a_prediction_are_those_of_its_draws(choice):
    prediction, test = choice.held_out, choice.test
    part = slice(prediction.start, None)
    dissipated = np.trapezoid(test.force[part], test.displacement[part])
    low, high = np.quantile(prediction.energies, [0.005, 0.995])
    assert low < dissipated < high < 1.5 * dissipated
    assert np.quantile(prediction.largest_forces, 0.95) < 1.2 * test.largest_force
    further = choice.predict(2.0 * PATH[:100])  # shorter than the test
    assert further.start == 0
    assert len(further.energies) == len(further.draws)


def test_the_error_of_a_law_is_one_number_in_a_half_cycle(wrong):
    """Errors that differ from sample to sample would make every largest force too large."""
    law = next(law for law in wrong.on_parts if law.word == "bilinear")
    along = wrong.test.along(2.0 * PATH)
    draws = law.draws(TO_ALL, along, 50, np.random.default_rng(0))
    halves = np.split(draws, along.turns, axis=1)
    # A bilinear force has a few bends in a half-cycle, and is straight between them.
    bends = [np.median(np.abs(np.diff(half, 2, axis=1))) for half in halves]
    assert np.median(bends) < 0.2 * law.sd(TO_ALL)


def test_a_strength_above_all_forces_of_a_test_is_not_reached(choice):
    assert choice.not_reached == ()
    weaker = si.CyclicTest(choice.test.displacement, 0.5 * choice.test.force)
    assert replace(choice, test=weaker).not_reached == ("yield_force",)


def test_the_page_names_the_laws_that_predict(choice):
    assert choice.averaging.endswith("the bilinear spring with kinematic hardening 100%.")
    doubtful = replace(choice)
    doubtful.__dict__["weights"] = {"bilinear": 0.3}
    assert "but its fits to earlier parts predict worse" in doubtful.averaging


def test_a_fit_to_all_half_cycles_learns_from_more_predictions(choice):
    law = choice.on_parts[0]
    assert len(law.trials(TO_ALL)) == len(law.trials(TO_FIRST_PART)) + 1
    assert len(law.scores(TO_ALL)) > len(law.scores(TO_FIRST_PART))


def test_laws_without_predictions_have_equal_weights(choice):
    without = [type(law)(law.test, law.fits[-2:]) for law in choice.on_parts]
    np.testing.assert_allclose(weights_by_prediction(without, TO_FIRST_PART), 1.0 / len(without))


def test_draws_of_a_posterior_replace_the_normal_approximation(choice):
    law = choice.on_parts[0]
    same = np.tile(law.fits[TO_FIRST_PART].best, (50, 1))
    first, without_spread = law.trials(TO_ALL)[-1], replace(law, sampled={TO_FIRST_PART: same}).trials(TO_ALL)[-1]
    np.testing.assert_array_equal(without_spread.error, first.error)
    assert np.max(without_spread.spread) < 1e-12 < np.median(first.spread)


def test_the_first_part_is_sampled_where_the_normal_approximation_misses_the_posterior(choice, tmp_path, monkeypatch):
    close = next(law for law in choice.on_parts if law.fits[TO_ALL] is choice.chosen.fit)
    assert set(close.sampled) == {TO_ALL}
    np.testing.assert_array_equal(close.sampled[TO_ALL], choice.result.flat[:, : len(choice.chosen.fit.fitted)])
    monkeypatch.setattr(choose_model, "MISSED", -1.0)
    missed = si.choose_model(choice.test, LAWS, seed=1, folder=tmp_path)
    of_first = next(law for law in missed.on_parts if law.fits[TO_ALL] is missed.chosen.fit).sampled[TO_FIRST_PART]
    best = missed.chosen.of_first.best
    assert (abs(of_first.mean(axis=0) - best) < 2.0 * of_first.std(axis=0)).all()
    assert missed.held_out.coverage > 0.85
    assert any("first_bilinear" in path.name for path in tmp_path.iterdir())


def test_stored_fits_give_the_same_choice(choice, tmp_path, monkeypatch):
    first = si.choose_model(choice.test, LAWS, seed=1, folder=tmp_path)
    np.testing.assert_array_equal(first.result.history, choice.result.history)

    def refuse(*args, **settings):
        raise AssertionError("a stored fit was computed again")

    monkeypatch.setattr("structid.law_choice.law_comparison.search_law", refuse)
    monkeypatch.setattr("structid.law_choice.law_comparison.refine_law", refuse)
    monkeypatch.setattr("structid.law_choice.choose_model.refine_law", refuse)
    again = si.choose_model(choice.test, LAWS, seed=1, folder=tmp_path)
    np.testing.assert_array_equal(again.result.history, choice.result.history)
    np.testing.assert_array_equal(again.held_out.draws, choice.held_out.draws)
    with pytest.raises(si.InputError, match="another study"):
        si.choose_model(choice.test, LAWS[1:], seed=1, folder=tmp_path)


def test_the_oscillator_has_the_chosen_law(choice):
    record = si.GroundMotion.synthetic(seed=3).trim(3.0, 6.0)
    oscillator = choice.oscillator(12e3, 0.02, ("displacement", "restoring_force"))
    draws = choice.result.flat[:3, : len(oscillator.free)]
    values = dict(zip(oscillator.free, draws[1], strict=True))
    offset = values.pop("force_offset")
    alone = si.Hysteretic(
        choice.chosen.law.word,
        values,
        mass=12e3,
        damping_ratio=0.02,
        force_offset=offset,
        channels=oscillator.channels,
    )
    expected = alone.simulate(np.zeros((1, 0)), record).values[0]
    np.testing.assert_allclose(oscillator.simulate(draws, record).values[1], expected, rtol=1e-9, atol=1e-12)


def test_a_parameter_that_the_test_does_not_show_is_named():
    """An elastic test says nothing of the yield force or the hardening."""
    path = 0.05 * path_between(np.array([0.01, -0.01] * 6), 30)
    force = 20e6 * path
    noisy = force + 0.02 * np.abs(force).max() * np.random.default_rng(0).normal(size=len(path))
    choice = si.choose_model(si.CyclicTest(path, noisy), ["bilinear"], seed=1)
    assert {"hardening"} <= set(choice.unidentified) or {"yield_force"} <= set(choice.unidentified)
    assert "stiffness" not in choice.unidentified


def test_a_push_over_is_fitted_and_predicts_nothing_of_itself():
    """A test without a turning point has no later half-cycles."""
    path = np.linspace(0.0, 0.03, 100)
    force = np.minimum(20e6 * path, 60e3) + 1e6 * np.maximum(path - 3e-3, 0.0)
    noisy = force + 500.0 * np.random.default_rng(0).normal(size=len(path))
    choice = si.choose_model(si.CyclicTest(path, noisy), LAWS, seed=1)
    assert choice.chosen.law.word == "bilinear"
    assert choice.on_parts == () and "half-cycles" not in choice.sentence
    assert "inf" not in str(choice) and "nan" not in str(choice)
    with pytest.raises(si.InputError, match="half-cycles"):
        choice.predict(2.0 * path)
