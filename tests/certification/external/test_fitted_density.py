"""Densities fitted to draws, and made wider: normalised, drawn from, and along a bent ridge."""

import numpy as np
import pytest
import scipy.stats

from structid.certification.external.fitted_density import FittedDensity, _unlikely

WIDTH = 1.4


def bent(count, seed=1):
    rng = np.random.default_rng(seed)
    a = rng.normal(0.0, 1.0, count)
    return np.column_stack([a, 0.5 * a**2 + 0.3 * rng.normal(size=count)])


@pytest.fixture(scope="module")
def fitted():
    return FittedDensity.of(bent(5000), np.random.default_rng(2))


@pytest.mark.parametrize("wider", [False, True])
def test_it_is_normalised(fitted, wider):
    """Integrated over a grid that holds nearly all of it."""
    a, b = np.linspace(-12.0, 12.0, 801), np.linspace(-12.0, 60.0, 1601)
    grid = np.stack(np.meshgrid(a, b, indexing="ij"), axis=-1).reshape(-1, 2)
    total = np.exp(fitted.log_density(grid, WIDTH if wider else 1.0)).sum() * (a[1] - a[0]) * (b[1] - b[0])
    assert total == pytest.approx(1.0, abs=1e-3)


def test_its_draws_are_of_its_density(fitted):
    """A probability by draws and by the density of other draws: importance weights have mean one."""
    rng = np.random.default_rng(3)
    wide, own = fitted.draw(40_000, rng, WIDTH), fitted.draw(40_000, rng)
    weights = np.exp(fitted.log_density(wide) - fitted.log_density(wide, WIDTH))
    assert abs(weights.mean() - 1.0) < 4.0 * weights.std() / np.sqrt(len(weights))
    event = weights * (wide[:, 1] > 1.0)
    error = np.hypot(event.std(), 0.5) / np.sqrt(len(event))
    assert abs(event.mean() - (own[:, 1] > 1.0).mean()) < 4.0 * error


def test_normal_coordinates_and_back(fitted):
    x = bent(200, seed=4)
    z, _ = fitted.in_normal_coordinates(x)
    np.testing.assert_allclose(fitted.of_normal_coordinates(z), x, rtol=1e-9, atol=1e-9)


def test_a_normal_law_made_wider_is_one():
    """No layer but the whitening is needed."""
    draws = scipy.stats.norm.ppf((np.arange(4000) + 0.5) / 4000)[:, None]
    law = FittedDensity.of(draws, np.random.default_rng(1))
    x = np.linspace(-5.0, 5.0, 21)
    expected = scipy.stats.norm.logpdf(x, scale=WIDTH)
    np.testing.assert_allclose(law.log_density(x[:, None], WIDTH), expected, atol=0.02)


def test_it_follows_a_ridge_beyond_its_ends(fitted):
    """Most of what is drawn twice as far out as any draw still lies near b = a²/2; a widened covariance does not."""
    rng = np.random.default_rng(5)
    wide = fitted.draw(20_000, rng, WIDTH)
    far = wide[(np.abs(wide[:, 0]) > 3.5) & (np.abs(wide[:, 0]) < 5.0)]
    plain = rng.multivariate_normal([0.0, 0.5], WIDTH**2 * np.cov(bent(5000).T), 20_000)
    beside = plain[(np.abs(plain[:, 0]) > 3.5) & (np.abs(plain[:, 0]) < 5.0)]

    def off(x):
        return np.median(np.abs(x[:, 1] - 0.5 * x[:, 0] ** 2))

    assert off(far) < 0.5 * off(beside)


def test_the_gradient_of_the_likelihood_is_that_of_differences():
    y, shape = np.random.default_rng(4).gamma(2.0, 1.0, 500), np.array([0.4, -0.2, 0.8, 0.1])
    steps = 1e-6 * np.eye(4)
    differences = [(_unlikely(shape + h, y)[0] - _unlikely(shape - h, y)[0]) / 2e-6 for h in steps]
    np.testing.assert_allclose(_unlikely(shape, y)[1], differences, atol=1e-8)
