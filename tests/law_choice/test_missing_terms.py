"""Terms of the force that a law lacks: as a law, sought in residuals, and as a further class in the choice."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from law_paths import TYPICAL, path_between, random_ends
from structid.inference.error_models.independent import IID
from structid.law_choice.law_comparison import LawCandidate
from structid.law_choice.law_fit import refine_law, search_law
from structid.law_choice.missing_terms import find_missing_terms
from structid.mechanics.hysteretic_laws.added_terms import TERMS, law_with_terms, states_along
from structid.mechanics.hysteretic_laws.law_list import LAWS, law_of

ENDS = 1e-3 * np.array([2, -2, 4, -4, 4, -4, 8, -8, 8, -8, 12, -12, 12, -12, 16, -16, 16, -16])
PATH = path_between(ENDS, 24)
SCALES = (16e-3, 80e3)
MISSING, COEFFICIENT = "s exp(-(4u)^2)", 8e3


def specimen(coefficient: float, noise: float = 0.01) -> si.CyclicTest:
    """A bilinear spring with friction near zero displacement."""
    law = law_with_terms(law_of("test", "bilinear"), [MISSING], SCALES)
    values = {"stiffness": "20 kN/mm", "yield_force": "60 kN", "hardening": 0.05, "term_1": coefficient}
    force = si.Hysteretic(law, values).simulate(np.zeros((1, 0)), si.DisplacementHistory(PATH, 1.0)).values[0, :, 0]
    return si.CyclicTest(PATH, force + noise * np.abs(force).max() * np.random.default_rng(0).normal(size=len(PATH)))


@pytest.mark.parametrize("word", LAWS)
def test_without_coefficients_a_law_with_terms_is_the_law(word):
    law = LAWS[word]().with_values(TYPICAL[word])
    path = path_between(random_ends(1)[:, 0], 20)
    np.testing.assert_array_equal(
        law_with_terms(law, ["s", "e u"], (1.0, 1.0)).forces_along(path), law.forces_along(path)
    )


def test_every_term_is_added_to_the_force():
    law = LAWS["bilinear"]().with_values(TYPICAL["bilinear"])
    path = path_between(random_ends(1)[:, 0], 20)
    force, scales = law.forces_along(path), (2.0, 1.5)
    states = states_along(path, force, scales)
    for name, term in TERMS.items():
        extended = law_with_terms(law, [name], scales).with_values({"term_1": 0.3})
        np.testing.assert_allclose(
            extended.forces_along(path) - force, 0.3 * term.value(states), atol=1e-12, err_msg=name
        )
    assert np.abs(states.s).max() == 1.0
    assert states.e[-1] > states.e[1] > 0.0


def test_a_law_with_terms_runs_in_many_lanes():
    law = law_with_terms(law_of("test", "bilinear"), [MISSING, "p z"], SCALES)
    values = {"stiffness": 20e6, "yield_force": 60e3, "hardening": 0.05}
    theta = np.array([[8e3, 0.0], [0.0, 5e3], [3e3, -2e3]])
    model = si.Hysteretic(law, values, free=("term_1", "term_2"))
    runs = model.simulate(theta, si.DisplacementHistory(PATH, 1.0)).values[:, :, 0]
    for row, (first, second) in zip(runs, theta, strict=True):
        alone = law.with_values(values | {"term_1": first, "term_2": second}).forces_along(PATH)
        np.testing.assert_allclose(row, alone, atol=1e-9 * np.abs(alone).max())


def candidate(test: si.CyclicTest) -> LawCandidate:
    law = law_of("test", "bilinear")
    (fit,) = refine_law(test, law, search_law(test.searched, law, 1), [IID()])
    (first,) = refine_law(test.first, law, search_law(test.first.searched, law, 1), [IID()])
    return LawCandidate(fit, first)


def test_a_missing_term_is_found_where_it_is_and_not_where_it_is_not():
    test = specimen(COEFFICIENT)
    missing = find_missing_terms(test, candidate(test))
    assert missing.names[0] == MISSING
    # The term is relative to the largest displacement; the fitted law has taken a part of it.
    assert missing.coefficients[0] == pytest.approx(COEFFICIENT, rel=0.35)
    assert missing.explained > 0.5
    assert missing.holds
    assert "friction near zero displacement" in missing.sentence
    none = find_missing_terms(specimen(0.0), candidate(specimen(0.0)))
    assert none.names == ()
    assert "follows no function" in none.sentence


@pytest.mark.slow
def test_a_law_with_its_missing_term_is_one_of_the_compared_laws():
    choice = si.choose_model(specimen(COEFFICIENT), ["elastic_plastic", "bilinear"], [IID()], seed=1)
    assert choice.missing is not None
    assert choice.chosen.law.word == f"bilinear + {', '.join(choice.missing.names)}"
    assert choice.mechanisms["friction near zero displacement"] > 5.0
    assert choice.chosen.unexplained == pytest.approx(
        0.01**2 / np.var(choice.test.force / choice.test.largest_force), rel=0.3
    )
    mean = dict(zip(choice.result.names, choice.result.mean, strict=True))
    sd = dict(zip(choice.result.names, choice.result.sd, strict=True))
    assert mean["term_1"] == pytest.approx(COEFFICIENT, abs=4.0 * sd["term_1"])
    assert choice.held_out.coverage > 0.7
    assert "one of the compared laws" in choice.sentence


def test_a_law_that_predicts_no_better_with_terms_is_not_compared(monkeypatch):
    def without_gain(chosen, missing, error_models, store):
        return [LawCandidate(replace(chosen.fit, law=missing.extended), chosen.of_first)]

    monkeypatch.setattr("structid.law_choice.choose_model.candidates_with_terms", without_gain)
    choice = si.choose_model(specimen(COEFFICIENT), ["bilinear"], [IID()], seed=1)
    assert choice.missing is not None
    assert choice.missing.holds
    assert [c.law.word for c in choice.candidates] == ["bilinear"]
    assert choice.sentence.endswith("to the first part, the law predicts the rest no better.")
