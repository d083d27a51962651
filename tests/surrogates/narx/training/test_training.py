"""Recursions against plain loops, exact sensitivities, training that finds what made the data."""

import itertools

import numpy as np
import pytest

from structid.surrogates.narx.structure.recursion import Recursion
from structid.surrogates.narx.structure.terms import (
    as_memories,
    as_terms,
)
from structid.surrogates.narx.training.free_run import FreeRun
from structid.surrogates.narx.training.least_squares import train_free_run
from structid.surrogates.narx.training.one_step_regression import joint_solution
from structid.surrogates.narx.training.training_set import TrainingSet

DT = 0.01


TERMS = as_terms(["x(t)", "x(t-2)", "y(t-1)", "y(t-2)*|y(t-1)|", "u(t-1)", "z(t-2)"])


MEMORIES = as_memories(["u = integral(y)", "z = hysteresis(u)"])


@pytest.fixture(scope="module")
def recursion():
    return Recursion((TERMS,), MEMORIES, ("x",), ("y",), DT, {"x": 1.0, "y": 2.0, "u": 0.1, "z": 1.0}, np.array([0.0]))


def by_hand(c, x):
    """The same recursion as a plain loop."""
    n, b, g = len(x), c[6], c[7]
    y, u, z = np.zeros(n), np.zeros(n), np.zeros(n)
    back = lambda s, t, k: s[t - k] if t >= k else 0.0  # noqa: E731
    for t in range(1, n):
        y[t] = (
            c[0] * x[t]
            + c[1] * back(x, t, 2)
            + c[2] * y[t - 1]
            + c[3] * back(y, t, 2) * abs(y[t - 1])
            + c[4] * u[t - 1]
            + c[5] * back(z, t, 2)
        )
        u[t] = u[t - 1] + 2.0 * DT / 0.1 * 0.5 * (y[t] + y[t - 1])
        du = u[t] - u[t - 1]
        slope = lambda m: du - b * abs(du) * m - g * du * abs(m)  # noqa: B023, E731
        z[t] = z[t - 1] + slope(z[t - 1] + 0.5 * slope(z[t - 1]))
    return y


@pytest.fixture(scope="module")
def coefficients():
    rng = np.random.default_rng(1)
    base = np.array([0.4, 0.2, 0.9, -0.05, -0.3, -0.2, 0.5, 0.2])
    return base + 0.02 * rng.normal(size=(5, 8))


@pytest.fixture(scope="module")
def signals():
    rng = np.random.default_rng(2)
    return np.cumsum(rng.normal(size=(5, 300)), axis=1) * 0.05


def test_the_free_run_is_the_plain_loop(recursion, coefficients, signals):
    from structid.engine.device import jnp

    x = jnp.asarray(np.append(signals[0], 0.0))[:, None]
    found = np.asarray(recursion.free_loop(jnp.asarray(coefficients.T), x, 1e3).run()[0])[:, 0].T
    for k in range(5):
        np.testing.assert_allclose(found[k], by_hand(coefficients[k], signals[0]), rtol=1e-9, atol=1e-12)


@pytest.fixture(scope="module")
def data(coefficients, signals):
    y = np.stack([by_hand(c, x) for c, x in zip(coefficients, signals, strict=True)])
    return TrainingSet(signals[:, :, None], y[:, :, None], np.ones(y.shape, dtype=bool), np.ones(len(y)))


def test_one_step_terms_reproduce_the_outputs(recursion, coefficients, data):
    """Along outputs it made itself the recursion's terms sum to them, so that regression returns the coefficients."""
    square, inner = FreeRun(recursion, 1e3).regression_equations(coefficients, data)
    for k in range(5):
        found = np.linalg.solve(square[k, 0, :6, :6], inner[k, 0, :6])
        np.testing.assert_allclose(found, coefficients[k, :6], rtol=1e-6)


@pytest.mark.parametrize("horizon", [None, 1, 7, 1000])
def test_a_free_run_of_the_true_coefficients_has_no_error(recursion, coefficients, data, horizon):
    assert FreeRun(recursion, 1e3, horizon).errors(coefficients, data).max() < 1e-20


@pytest.mark.parametrize("horizon", [None, 20])
def test_sensitivities_are_exact(recursion, coefficients, data, horizon):
    """Jᵀr is minus half the gradient of Σ r², by central differences."""
    run = FreeRun(recursion, 1e3, horizon)
    moved = coefficients + 0.01
    _, inner = run.normal_equations(moved, data)
    for j in range(8):
        up, down = moved.copy(), moved.copy()
        up[:, j] += 1e-6
        down[:, j] -= 1e-6
        slope = (run.errors(up, data) - run.errors(down, data)) / 2e-6
        np.testing.assert_allclose(inner[:, :, j], -0.5 * slope, rtol=1e-4, atol=1e-7 * np.abs(inner).max())


def test_training_on_the_free_run_returns_to_what_made_the_data(recursion, coefficients, data):
    run = FreeRun(recursion, 50.0)
    features = np.ones((5, 1))
    shared = coefficients.mean(axis=0)
    own = TrainingSet(data.x, run.outputs(np.tile(shared, (5, 1)), data), data.counted, data.weights)
    start = (shared * (1 + 0.03 * np.random.default_rng(3).normal(size=8)))[:, None]
    trained = train_free_run(run, start, features, own, None, 30, 1e-3)
    losses = [h["loss"] for h in trained.history]
    assert all(b < a for a, b in itertools.pairwise(losses))
    np.testing.assert_allclose(trained.coefficients[:, 0], shared, rtol=1e-3, atol=1e-4)


def test_the_joint_solution_is_the_stacked_regression():
    rng = np.random.default_rng(4)
    features, a = rng.normal(size=(20, 3)), rng.normal(size=(4, 3))
    regressors = rng.normal(size=(20, 50, 4))
    response = np.einsum("rti,ip,rp->rt", regressors, a, features)
    square, inner = np.einsum("rti,rtj->rij", regressors, regressors), np.einsum("rti,rt->ri", regressors, response)
    np.testing.assert_allclose(joint_solution(square, inner, features, np.ones(20), 0.0), a, rtol=1e-9)


def test_a_run_that_diverges_is_a_large_number(recursion, data):
    wild = np.tile([1.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.5, 0.0], (5, 1))
    errors = FreeRun(recursion, 10.0).errors(wild, data)
    assert np.isfinite(errors).all() and (errors > 10).all()
