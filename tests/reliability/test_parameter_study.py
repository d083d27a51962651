"""What runs over a box tell: probabilities by logistic regression, Sobol' indices, a whole study."""

from __future__ import annotations

import numpy as np
import pytest

import structid as si
from structid.reliability.parameter_study import parameter_study
from structid.reliability.passage_probability import coordinates_of


def tossed(count: int, slope: float, seed: int) -> tuple[si.Passages, np.ndarray]:
    """Passages whose probability is logistic in x, and that probability."""
    space = si.ParameterSpace(x=si.Uniform(-1.0, 1.0), y=si.Uniform(-1.0, 1.0))
    design = space.sample(count, seed, "random")
    probability = 1.0 / (1.0 + np.exp(-(0.5 + slope * design.values[:, 0])))
    passed = np.random.default_rng(seed).uniform(size=count) < probability
    return si.Passages(design, "drift", 1.0, np.where(passed, 0.5, np.nan), np.ones(count)), probability


def test_a_logistic_probability_is_found_and_its_log_loss_is_the_entropy() -> None:
    passages, probability = tossed(4000, 3.0, 1)
    found = si.passage_probability(passages)
    estimated = found.probability(passages.design.values)
    assert np.sqrt(np.mean((estimated - probability) ** 2)) < 0.02  # three coefficients of 4000 tosses
    each = -(probability * np.log(probability) + (1 - probability) * np.log(1 - probability))
    error = np.std(np.log(probability / (1 - probability)) * np.sqrt(probability * (1 - probability))) / np.sqrt(4000)
    assert abs(found.log_loss - each.mean()) < 4.0 * error
    assert found.log_loss < found.base_log_loss - 10.0 * error


def test_a_coin_is_not_explained() -> None:
    passages, _ = tossed(2000, 0.0, 2)
    found = si.passage_probability(passages)
    assert found.log_loss > found.base_log_loss - 0.003, "cross-validation must not praise what is noise"


def test_a_product_needs_a_coordinate() -> None:
    """Who passes depends on a b alone: one coordinate separates what the parameters do not."""
    prior = dict(a=si.Uniform(1.0, 10.0), b=si.Uniform(1.0, 10.0))
    plain, with_product = (si.ParameterSpace(**prior, coordinates=c) for c in (None, {"product": "log(a * b)"}))
    losses = []
    for space in (plain, with_product):
        design = space.sample(1000, 4)
        passed = design.values[:, 0] * design.values[:, 1] > 20.0
        passages = si.Passages(design, "drift", 1.0, np.where(passed, 0.5, np.nan), np.ones(1000))
        losses.append(si.passage_probability(passages, degrees=(1,)).log_loss)
        assert coordinates_of(space, design.values).shape[1] == (1 if space.coordinates else 2)
    assert losses[1] < 0.2 * losses[0]


def test_too_few_passages_are_refused() -> None:
    passages, _ = tossed(12, 0.0, 5)
    with pytest.raises(si.InputError, match="of 12 runs passed the limit"):
        si.passage_probability(passages)


def test_sobol_indices_of_ishigamis_function() -> None:
    """y = sin x₁ + 7 sin² x₂ + 0.1 x₃⁴ sin x₁: S = (.3139, .4424, 0), T = (.5576, .4424, .2437)."""
    names = ("x1", "x2", "x3")
    space = si.ParameterSpace(**{n: si.Uniform(-np.pi, np.pi) for n in names})
    design = space.sample(1000, 1)
    x = design.values.T
    values = np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])
    found = si.sensitivity(design, values, si.PCE(degree=12))
    assert found.left_out < 1e-3
    np.testing.assert_allclose(found.first, [0.3139, 0.4424, 0.0], atol=0.02)
    np.testing.assert_allclose(found.total, [0.5576, 0.4424, 0.2437], atol=0.02)
    np.testing.assert_allclose(found.alone, [0.3139, 0.4424, 0.0], atol=0.03)


def test_a_coordinate_alone_explains_a_function_of_it() -> None:
    coordinates = {"stiffness": "log(strength**2 / energy)", "log_strength": "log(strength)"}
    prior = dict(energy=si.Uniform(1.0, 10.0), strength=si.Uniform(1.0, 3.0))
    design = si.ParameterSpace(**prior, coordinates=coordinates).sample(400, 2)
    energy, strength = design.values.T
    found = si.sensitivity(design, (strength**2 / energy) ** 0.5)
    assert found.alone[0] > 0.98
    assert found.alone[1] < 0.7
    assert 0.0 < found.total.sum() - 1.0 < 0.1, "the parameters interact"


def test_a_single_parameter_has_all_of_the_variance():
    space = si.ParameterSpace(stiffness=si.Uniform(1.0, 2.0))
    design = space.sample(60, seed=1)
    found = si.sensitivity(design, design.values[:, 0] ** 2)
    assert found.first.tolist() == found.total.tolist() == [1.0]
    assert found.alone == pytest.approx([1.0], abs=0.01)
    assert "stiffness" in str(found)


@pytest.mark.parametrize("shape", [(50,), (200,), (100, 2), ()])
def test_values_of_other_runs_are_refused(shape):
    space = si.ParameterSpace(a=si.Uniform(1.0, 2.0), b=si.Uniform(1.0, 2.0))
    with pytest.raises(si.InputError, match=r"sensitivity\(values\): .* for 100 runs"):
        si.sensitivity(space.sample(100, seed=1), np.ones(shape))


def test_correlated_parameters_have_no_such_indices() -> None:
    space = si.ParameterSpace(correlation=[[1.0, 0.5], [0.5, 1.0]], a=si.Uniform(0.0, 1.0), b=si.Uniform(0.0, 1.0))
    design = space.sample(100, 1)
    with pytest.raises(si.InputError, match="independent"):
        si.sensitivity(design, design.values.sum(axis=1))


def test_a_box_of_oscillators() -> None:
    """Soft ones pass: of stiffness, and of nothing else."""
    space = si.ParameterSpace(
        stiffness=si.Uniform(1.0, 12.0, unit="kN/mm"), alpha=si.Uniform(0.3, 0.5), beta=si.Uniform(1.0, 5.0)
    )
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, gamma_ratio=0.5, free=space.names, channels=("displacement",))
    record = si.GroundMotion.synthetic(seed=3, duration=10.0).scale_to_pga(1.0)
    design = space.sample(300, 1)
    runs = si.Runs.from_histories(design, model.simulate(design, record), record)
    largest = np.abs(runs.channel("displacement")).max(axis=1)
    limit = float(np.median(largest))
    found = parameter_study(runs, "displacement", [limit, 10.0], {"stiffness": 6e6}, ["displacement"])
    assert found.passages[0].share[0] == 0.5
    assert found.passages[1].share[0] == 0.0
    assert found.probabilities[1] is None
    assert found.leading(0)[0] == "stiffness"
    assert found.sensitivities["displacement"].total.argmax() == 0
    assert found.inside.sum() == (design.values[:, 0] > 6e6).sum()
    with pytest.raises(si.InputError, match="stifness"):
        parameter_study(runs, "displacement", [limit], {"stifness": 6e6})
