"""Comparison of model classes: stretches left out against refitted answers, Bayes factors."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.core.errors import InputError
from structid.inference.model_comparison.comparison import Comparison, LeaveOut, ModelClass, leave_out
from structid.inference.sampling.base import Evidence


class Line(si.BoucWen):
    """y = a x(t): a linear model in a posterior's clothes, so that everything has a closed form."""

    def __init__(self, regressor):
        super().__init__(mass=1.0, damping_ratio=0.0, beta=0.0, gamma=0.0, alpha=1.0, free=("stiffness",), substeps=1)
        self.regressor = regressor

    def check_priors(self, space):
        """A slope may be negative."""

    def response(self, theta, excitation):
        from structid.engine.device import jnp

        return jnp.asarray(self.regressor)[:, None, None] * theta[None, None, :, 0], jnp.ones(len(theta), dtype=bool)


def test_stretches_left_out_as_by_fitting_again():
    rng = np.random.default_rng(1)
    samples, noise, prior = 200, 0.5, 2.0
    x = rng.normal(size=samples)
    y = 1.3 * x + noise * rng.normal(size=samples)
    record = si.GroundMotion(np.ones(samples), 0.01)
    space = si.ParameterSpace(stiffness=si.Normal(0.0, prior))
    posterior = si.Posterior(space, Line(x), si.Observation(record, y), si.IID(variance=noise**2))

    def conditioned(rows):
        precision = (x[rows] ** 2).sum() / noise**2 + 1.0 / prior**2
        return (x[rows] @ y[rows]) / noise**2 / precision, 1.0 / precision

    mean, variance = conditioned(np.arange(samples))
    draws = mean + np.sqrt(variance) * rng.normal(size=(4000, 1))
    found = leave_out(posterior, draws, blocks=20)
    for block, value in zip(np.arange(samples).reshape(20, 10), found.each, strict=True):
        mean, variance = conditioned(np.setdiff1d(np.arange(samples), block))
        covariance = noise**2 * np.eye(10) + variance * np.outer(x[block], x[block])
        expected = scipy.stats.multivariate_normal(mean * x[block], covariance).logpdf(y[block])
        assert value == pytest.approx(expected, abs=0.05)
    assert found.unreliable == 0 and found.value == pytest.approx(found.each.sum())
    with pytest.raises(InputError, match="blocks"):
        leave_out(posterior, draws, blocks=500)


def one(name, value, error=0.1, each=None, trusted=True):
    evidence = None if value is None else Evidence(value, error, np.array([value]))
    each = np.zeros(10) if each is None else each
    return ModelClass(name, evidence, LeaveOut(each, np.zeros(10)), 3, 0.1, 0.9, trusted)


def test_bayes_factors_and_probabilities():
    found = Comparison((one("a", -10.0), one("b", -12.0), one("c", -30.0)))
    assert found.best.name == "a" and found.bayes_factor(found.classes[1]) == (-2.0, pytest.approx(0.1414, abs=1e-3))
    np.testing.assert_allclose(found.probabilities, scipy.special.softmax([-10.0, -12.0, -30.0]))
    assert "slightly favours a" in found.verdict and "b" in found.verdict
    assert "clearly favours a" in Comparison((one("a", 0.0), one("b", -50.0))).verdict
    assert "is inconclusive" in Comparison((one("a", 0.0), one("b", -0.1))).verdict
    assert "not converged or not certified: b" in Comparison((one("a", 0.0), one("b", -9.0, trusted=False))).verdict
    heads, rows = found.rows()
    assert [r[0] for r in rows] == ["a", "b", "c"] and all(len(r) == len(heads) for r in rows)
    assert found.side_by_side()[0] == ["", "a", "b", "c"]


def test_without_evidence_what_is_left_out_decides():
    better = one("b", None, each=np.linspace(1.0, 2.0, 10))
    found = Comparison((one("a", -1.0), better))
    assert found.best is better and "best predicts" in found.verdict and np.isnan(found.probabilities).all()
    gap, error = found.classes[0].left_out.less(better.left_out)
    assert gap == pytest.approx(-15.0) and error == pytest.approx(np.sqrt(10 * np.linspace(1, 2, 10).var(ddof=1)))
