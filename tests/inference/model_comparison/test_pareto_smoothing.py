"""Pareto smoothing and R-hat: ArviZ's answers, the shape of known tails, and what cannot be fitted."""

import arviz
import numpy as np
import pytest
import scipy.stats

from structid.inference.convergence import r_hat
from structid.inference.model_comparison.pareto_smoothing import pareto_fit, smoothed_weights

pytestmark = pytest.mark.quick


@pytest.fixture
def rng():
    return np.random.default_rng(2)


SAME = dict(rtol=1e-8, atol=1e-8) if hasattr(arviz, "psislw") else dict(rtol=0.1, atol=0.05)
"""ArviZ 1 takes one draw more or less for the tail."""


def of_arviz(log_ratios):
    """ArviZ 1 takes log likelihoods, whose negatives are the log weights of leave-one-out."""
    if hasattr(arviz, "psislw"):
        weights, k_hat = arviz.psislw(log_ratios)
    else:
        from arviz_stats.base import array_stats

        weights, k_hat = array_stats.psislw(-log_ratios)
    weights = np.asarray(weights)
    return np.exp(weights - np.logaddexp.reduce(weights)), float(k_hat)


@pytest.mark.parametrize("count", [30, 240, 5000])
@pytest.mark.parametrize("spread", [0.05, 0.5, 2.0])
def test_arviz_says_the_same(count, spread, rng):
    log_ratios = spread * rng.normal(size=count)
    (ours, k_hat), (theirs, expected) = smoothed_weights(log_ratios), of_arviz(log_ratios)
    np.testing.assert_allclose(k_hat, expected, **SAME)
    np.testing.assert_allclose(ours, theirs, **SAME)


@pytest.mark.parametrize("k", [-0.3, 0.2, 0.7])
def test_the_fit_finds_the_shape(k, rng):
    """Within 4.5 standard errors of repeated fits, but for the weak prior, which draws by 10 in 2010 towards a half."""
    found = [pareto_fit(np.sort(scipy.stats.genpareto.rvs(k, size=2000, random_state=rng)))[0] for _ in range(40)]
    drawn, error = (2000 * k + 10 * 0.5) / 2010, np.std(found) / np.sqrt(40)
    assert abs(np.mean(found) - drawn) < 4.5 * error < abs(np.mean(found) - drawn - 0.05)


def test_weights_keep_their_order_and_sum_to_one(rng):
    log_ratios = 2.0 * rng.normal(size=500)
    weights, _ = smoothed_weights(log_ratios)
    assert weights.sum() == pytest.approx(1.0) and (np.diff(weights[np.argsort(log_ratios)]) >= 0).all()


def test_what_has_no_weight_gets_none(rng):
    log_ratios = np.append(rng.normal(size=300), [-np.inf, -np.inf])
    weights, k_hat = smoothed_weights(log_ratios)
    assert (weights[-2:] == 0).all() and np.isfinite(k_hat)
    nothing, k_hat = smoothed_weights(np.full(10, -np.inf))
    assert (nothing == 0.1).all() and k_hat == np.inf


def test_what_cannot_be_fitted(rng):
    assert smoothed_weights(rng.normal(size=12))[1] == np.inf  # a tail of three
    assert smoothed_weights(np.full(100, 3.0))[1] == -np.inf
    two_values = np.where(np.arange(200) % 4 == 0, 1.0, 0.0)  # a tail of equal weights
    weights, k_hat = smoothed_weights(two_values)
    assert k_hat == np.inf and np.ptp(weights[::4]) == 0.0


@pytest.mark.parametrize("apart", [0.0, 0.3])
def test_r_hat_is_that_of_arviz(apart, rng):
    draws = rng.normal(size=(101, 4, 3)) + apart * np.arange(4)[:, None]
    chains = draws.transpose(1, 0, 2).reshape(4, -1)
    assert r_hat(draws) == pytest.approx(float(arviz.rhat(chains)), rel=1e-9)
