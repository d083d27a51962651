"""From one normal density to another: the correction is what the closed form says, and the certificate reckons with it."""

import numpy as np
import pytest
import scipy.stats

from structid.certification.certificate import issue_certificate
from structid.certification.correction import Correction
from structid.certification.fresh_draws import FreshDraws, StoredRuns
from structid.certification.limits import Limits

NAMES = ("a", "b")


def between(mean, sd, count=40_000, seed=1):
    """From q = N(0, 1)² to N(mean, sd²), by draws of a law 1.4 times as wide as q."""
    rng = np.random.default_rng(seed)
    theta = 1.4 * rng.standard_normal((count, 2))
    wide = scipy.stats.norm.pdf(theta, 0.0, 1.4).prod(axis=1)
    of_law, of_other = (scipy.stats.norm.pdf(theta, *law).prod(axis=1) / wide for law in ((0.0, 1.0), (mean, sd)))
    return Correction.between(theta, of_law, of_other)


@pytest.mark.parametrize("seed", range(3))
def test_closed_form(seed):
    mean, sd = np.array([0.1, -0.2]), np.array([1.1, 0.85])
    found = between(mean, sd, seed=seed)
    assert np.all(np.abs(found.mean - mean) < 4.0 * found.mean_error)
    np.testing.assert_allclose(found.sd, sd, rtol=0.02)
    grid = np.linspace(-8.0, 8.0, 1201)
    one = [scipy.stats.norm.pdf(grid, m, s) for m, s in zip(mean, sd, strict=True)]
    plain = scipy.stats.norm.pdf(grid)
    exact = 0.5 * np.abs(np.outer(*one) - np.outer(plain, plain)).sum() * (grid[1] - grid[0]) ** 2
    assert found.distance == pytest.approx(exact, rel=0.03)


def test_the_error_of_the_mean_is_that_of_repetitions():
    means = np.array([between(np.array([0.1, 0.0]), np.ones(2), 2000, s).mean[0] for s in range(200)])
    told = np.mean([between(np.array([0.1, 0.0]), np.ones(2), 2000, s).mean_error[0] for s in range(20)])
    assert 0.7 < told / means.std() < 1.5


def certificate(correction):
    """Draws that agree with q′ to 0.02 nats."""
    rng = np.random.default_rng(3)
    theta = rng.standard_normal((60, 2))
    log_true = scipy.stats.norm.logpdf(theta).sum(axis=1)
    fresh = FreshDraws(
        theta,
        theta,
        log_true + 0.02 * rng.standard_normal(60),
        log_true,
        np.ones(60),
        rng.standard_normal((4000, 2)),
        log_true.max(),
    )
    return issue_certificate(fresh, StoredRuns(), NAMES, 60, 1, Limits(), correction=correction)


def test_a_small_correction_is_certified_and_a_large_one_is_not():
    near, far = between([0.05, 0.0], [1.0, 0.97]), between([0.15, 0.0], [1.0, 1.0])
    plain, found, refused = certificate(None), certificate(near), certificate(far)
    assert plain.certified and found.certified and not refused.certified
    assert plain.mean_bound.max() < 0.04
    np.testing.assert_allclose(found.mean_bound[0] - plain.mean_bound[0], 0.05, atol=0.03)
    assert found.of_probability(0.05) > near.distance > plain.of_probability(0.05)
    assert "the mean of a is shifted by +0.15" in str(refused)
    assert not near.beyond(Limits()) and far.beyond(Limits())
    assert found.to_plain()["correction"]["mean"] == found.correction.mean.tolist()


def with_correlation(rho, count=40_000, seed=1):
    """From q = N(0, 1)² to standard normal parameters with a correlation."""
    theta = 1.4 * np.random.default_rng(seed).standard_normal((count, 2))
    wide, plain = (scipy.stats.norm.pdf(theta, 0.0, sd).prod(axis=1) for sd in (1.4, 1.0))
    other = scipy.stats.multivariate_normal.pdf(theta, np.zeros(2), [[1.0, rho], [rho, 1.0]])
    return Correction.between(theta, plain / wide, other / wide)


@pytest.mark.parametrize("rho", [0.3, -0.6])
def test_the_change_of_a_correlation(rho):
    found = with_correlation(rho)
    np.testing.assert_allclose(found.correlation, [[0.0, rho], [rho, 0.0]], atol=0.02)
    np.testing.assert_allclose(found.sd, 1.0, atol=0.03)


def test_draws_without_a_correlation_that_the_runs_have_taught():
    """Every mean and every standard deviation of single parameters is right, and still they are not the posterior's draws."""
    near, far = with_correlation(0.1), with_correlation(0.3)
    found, refused = certificate(near), certificate(far)
    assert found.certified and not near.beyond(Limits()) and far.beyond(Limits())
    assert "every correlation within 0.1" in found.statement
    assert len(refused.reasons) == 1
    assert refused.reasons[0].startswith("the correlation of a and b may be wrong by 0.3")
    assert refused.reasons[0].endswith("; the limit is 0.2")
