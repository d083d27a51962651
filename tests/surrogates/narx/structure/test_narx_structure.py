"""The structure of a NARX: signals, memories, which terms are kept, where its coefficients begin."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.surrogates.narx.structure.candidate_terms import absolute_terms
from structid.surrogates.narx.structure.experiments import Experiments, NARXSignals
from structid.surrogates.narx.structure.narx_structure import build_recursion
from structid.surrogates.narx.training.free_run import FreeRun
from structid.surrogates.narx.training.one_step_regression import first_coefficients
from structid.surrogates.narx.training.term_selection import select_terms
from structid.surrogates.narx.training.training_set import training_set

DT = 0.01


@pytest.mark.parametrize(
    ("terms", "memories", "words"),
    [
        (("v(t-1)",), (), r"the signal 'v'.*x, y"),
        (("y(t)",), (), r"y\(t\).*Use a past value"),
        (("y(t-1)",), ("u = integral(w)",), "the signal 'w'"),
        (("y(t-1)",), ("u = mean(y)",), "integral"),
        (("y(t-1)",), ("u is y",), "u = integral"),
        ((), (), "one or more terms"),
    ],
)
def test_a_structure_that_does_not_fit(terms, memories, words):
    experiments = Experiments(
        np.ones((1, 9, 1)), np.ones((1, 9, 1)), np.ones((1, 9), dtype=bool), DT, NARXSignals(("x",), ("velocity",))
    )
    with pytest.raises(InputError, match=words):
        build_recursion(experiments, terms, memories)


@pytest.fixture(scope="module")
def signals():
    rng = np.random.default_rng(2)
    return np.cumsum(rng.normal(size=(5, 300)), axis=1) * 0.05


def test_selection_finds_the_terms_that_are_there(signals):
    rng = np.random.default_rng(5)
    y = np.zeros((5, 300))
    for t in range(1, 300):
        y[:, t] = 0.7 * y[:, t - 1] + 0.5 * signals[:, t] - 0.2 * signals[:, t] * np.abs(y[:, t - 1])
    y += 1e-6 * rng.normal(size=y.shape)
    experiments = Experiments(
        signals[:, :, None], y[:, :, None], np.ones(y.shape, dtype=bool), DT, NARXSignals(("x",), ("velocity",))
    )
    recursion = build_recursion(experiments, absolute_terms(2, 2), ())
    for method in ("lars", "orthogonal"):
        kept = select_terms(FreeRun(recursion, 50.0), training_set(experiments, recursion), method, 5)
        assert {"x(t)", "y(t-1)", "x(t)*|y(t-1)|"} <= {str(t) for t in kept.terms[0]}
        assert len(kept.terms[0]) <= 5


def test_the_first_coefficients_choose_the_shape_of_a_hysteresis():
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 12.0).scale_to_pga(3.0)
    space = si.ParameterSpace(gamma_ratio=si.Uniform(-0.5, 0.8))
    model = si.BoucWen(mass=12_000.0, stiffness=7e6, alpha=0.05, beta=60.0, damping_ratio=0.03, free=space.names)
    design = space.sample(20, seed=1)
    runs = si.Runs.from_histories(design, model.simulate(design, record), record)
    experiments = Experiments.of(runs, record.dt)
    recursion = build_recursion(experiments, None, ())
    found = first_coefficients(FreeRun(recursion, 20.0), np.ones((20, 1)), training_set(experiments, recursion))
    assert found[-2, 0] > 0 and found[-1, 0] == 0


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(terms={"speed": ["x(t)"]}), "terms for the channels speed.*velocity"),
        (dict(memories=["z = hysteresis(y)"]), "no memories without terms"),
    ],
)
def test_structures_that_say_too_little(settings, words):
    experiments = Experiments(
        np.ones((1, 9, 1)), np.ones((1, 9, 1)), np.ones((1, 9), dtype=bool), DT, NARXSignals(("x",), ("velocity",))
    )
    with pytest.raises(InputError, match=words):
        build_recursion(experiments, settings.get("terms"), settings.get("memories", ()))
