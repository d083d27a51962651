"""A measured cyclic test: its half-cycles and scales, what it cannot show, and what is wrong with it."""

import numpy as np
import pytest

import structid as si
from law_paths import path_between
from structid.core.errors import InputError
from structid.law_choice.cyclic_test import turning_points
from structid.mechanics.hysteretic_laws.law_list import LAWS, law_of

ENDS = 1e-3 * np.array([2.0, -2.0, 4.0, -4.0, 8.0, -8.0, 12.0, -12.0, 16.0, -16.0, 0.0])
PATH = path_between(ENDS, 40)


def force(path, **values):
    law = {"stiffness": "20 kN/mm", "yield_force": "60 kN", "hardening": 0.05}
    model = si.Hysteretic("bilinear", law | values)
    return model.simulate(np.zeros((1, 0)), si.DisplacementHistory(path, 1.0)).values[0, :, 0]


def test_half_cycles_and_scales():
    noisy = PATH + 5e-6 * np.random.default_rng(0).normal(size=len(PATH))
    test = si.CyclicTest(noisy, force(PATH))
    np.testing.assert_allclose(test.displacement[test.turns], ENDS[:-1], atol=3e-5)
    assert test.initial_stiffness == pytest.approx(20e6, rel=0.02)
    assert test.until(0.7) == test.turns[round(0.7 * 11) - 1]
    assert test.questions == ()


def test_turning_points_of_a_history_that_starts_downwards():
    np.testing.assert_array_equal(turning_points(np.array([0.0, -1.0, -2.0, -1.0, 1.0, 3.0, 2.0]), 0.5), [2, 5])


def test_a_thinned_test_keeps_its_turning_points():
    test = si.CyclicTest(PATH, force(PATH))
    thin = test.thinned(60)
    assert len(thin.force) < 80
    assert set(test.displacement[test.turns]) <= set(thin.displacement)
    assert test.thinned(10_000) is test


def test_default_priors_hold_the_test():
    """Every law has priors for any test, and their draws are usable."""
    test = si.CyclicTest(PATH, force(PATH))
    for word in LAWS:
        space = test.priors(law_of("test", word))
        model = si.Hysteretic(word, free=space.names)
        model.check_priors(space)
        runs = model.simulate(space.sample(64, seed=1).values, test.path)
        assert runs.done.mean() > 0.5, word
    assert test.priors(law_of("test", "linear")).units == {"stiffness": "kN/mm", "force_offset": "kN"}


@pytest.mark.parametrize(
    ("displacement", "measured", "words"),
    [
        (PATH, -force(PATH), "Multiply one of the two columns by -1"),
        (PATH[:10], force(PATH)[:10], "20 or more samples"),
        (PATH, force(PATH)[:-1], "shapes"),
        (np.where(np.arange(len(PATH)) == 7, np.nan, PATH), force(PATH), "1 of 440 samples"),
        (np.zeros(50), np.arange(50.0), "a constant displacement"),
    ],
)
def test_refused(displacement, measured, words):
    with pytest.raises(InputError, match=words):
        si.CyclicTest(displacement, measured)


@pytest.mark.parametrize(
    ("path", "change", "words"),
    [
        (np.abs(PATH), lambda f: f, "one direction only"),
        (PATH[:160], lambda f: f, "half-cycles"),
        (PATH, lambda f: f + 6e3, "preload"),
        (np.delete(PATH, slice(200, 230)), lambda f: f, "jumps by"),
        (1e3 * PATH, lambda f: f, "check the units"),
    ],
)
def test_questions(path, change, words):
    test = si.CyclicTest(path, change(force(path)))
    assert any(words in question for question in test.questions), test.questions


def test_exchanged_columns_are_suspected():
    measured = force(PATH, hardening=0.02)
    exchanged = si.CyclicTest(1e-6 * measured, 1e6 * PATH)
    assert any("exchanged" in question for question in exchanged.questions), exchanged.questions
    assert not any("exchanged" in question for question in si.CyclicTest(PATH, measured).questions)
