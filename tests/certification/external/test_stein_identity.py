"""Stein's identity at draws: moments of a density from its scores, and null distributions that hold for an inexact surrogate."""

import numpy as np
import pytest
import scipy.signal
import scipy.stats

import structid as si
from structid.certification.external.draws_without_density import ValuesAtDraws
from structid.certification.external.scores_at_draws import Scores, _blocks_of, _stein_kernel
from structid.certification.external.stein_identity import Deviation, SteinTest
from structid.certification.monte_carlo_error import MonteCarloError

pytestmark = pytest.mark.quick


def scores(z, values, log_weights=None):
    """Scores of one chain."""
    weights = np.exp(np.zeros(len(z)) if log_weights is None else log_weights)
    return Scores(z, values, weights / weights.sum(), _blocks_of(1, len(z))[0])


def test_the_moments_of_a_normal_density_are_exact_whatever_the_draws():
    covariance = np.array([[1.0, 0.5], [0.5, 2.0]])
    z = np.random.default_rng(1).gamma(2.0, size=(300, 2))
    found = scores(z, -(z - [0.3, -0.2]) @ np.linalg.inv(covariance))
    np.testing.assert_allclose(found.moments_of_q[0], [0.3, -0.2], atol=1e-10)
    np.testing.assert_allclose(found.moments_of_q[1], covariance, atol=1e-10)


def test_the_kernel_is_steins_operator_on_both_arguments():
    rng = np.random.default_rng(2)
    z, values = rng.normal(size=(3, 2)), rng.normal(size=(3, 2))

    def kernel(x, y):
        return (1.0 + np.sum((x - y) ** 2) / 2.0) ** -0.5

    def once(x, s, y):  # s·c + ∂c/∂x
        steps = 1e-4 * np.eye(2)
        return s * kernel(x, y) + np.array([(kernel(x + h, y) - kernel(x - h, y)) / 2e-4 for h in steps])

    expected = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            steps = 1e-4 * np.eye(2)
            by_other = [(once(z[i], values[i], z[j] + h) - once(z[i], values[i], z[j] - h)) / 2e-4 for h in steps]
            expected[i, j] = values[j] @ once(z[i], values[i], z[j]) + sum(by_other[k][k] for k in range(2))
    np.testing.assert_allclose(_stein_kernel(z, values), expected, atol=1e-6)


def normal_draws(rng):
    z = rng.normal(size=(400, 2))
    return scores(z, -z), 400.0


def draws_with_an_inexact_surrogate(rng):
    """k = log q − 0.15 |z|² + 0.1 z₁³/3 within the draws: a Kriging that is wrong by half a nat."""
    z = rng.normal(size=(400, 2))
    excess = -0.15 * np.sum(z**2, axis=1) + 0.1 * np.sin(z[:, 0])
    slope = -1.3 * z + 0.1 * np.stack([np.cos(z[:, 0]), 0.0 * z[:, 0]], axis=1)
    return scores(z, slope, excess), 400.0


def chain(rng):
    """Autocorrelation time 5."""
    rho = 4.0 / 6.0
    noise = rng.normal(size=(1000, 2)) * np.sqrt(1.0 - rho**2)
    z = scipy.signal.lfilter([1.0], [1.0, -rho], noise, axis=0)
    return scores(z, -z), 1000.0 / 5.0


@pytest.mark.parametrize("draws", [normal_draws, draws_with_an_inexact_surrogate, chain])
@pytest.mark.parametrize("kind", ["moment_probability", "kernel_probability"])
def test_probabilities_of_draws_of_the_density_are_uniform(draws, kind):
    found = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        given, independent = draws(rng)
        found.append(getattr(given, kind)(independent, rng))
    # A conservative null distribution is allowed, false alarms are not: 5 ± 2.2 of 100 are below 5 %.
    assert np.mean(np.array(found) < 0.05) <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / 100)
    assert np.mean(found) == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize(
    "wrong",
    [lambda rng: 1.2 * rng.normal(size=(400, 2)), lambda rng: rng.normal([0.25, 0.0], 1.0, (400, 2)),
     lambda rng: scipy.stats.laplace.rvs(size=(400, 2), random_state=rng) / np.sqrt(2.0)],
    ids=["too wide", "shifted", "too long tails"],
)  # fmt: skip
def test_other_draws_are_improbable(wrong):
    rng = np.random.default_rng(3)
    z = wrong(rng)
    assert min(scores(z, -z).moment_probability(400.0, rng), scores(z, -z).kernel_probability(400.0, rng)) < 0.01


def examined(log_density, draws):
    names = tuple(f"x{i}" for i in range(draws.shape[1]))
    space = si.ParameterSpace(**{name: si.Uniform(-50.0, 50.0) for name in names})
    target = si.LogDensity(log_density, names, space, dict.fromkeys(names, (-50.0, 50.0)))
    drawn = ValuesAtDraws(target, draws[None], log_density(draws), np.random.default_rng(0))
    by_chance = MonteCarloError.of(drawn.in_order(draws), 0.95)
    return SteinTest.of(drawn, drawn.interpolation, by_chance, np.random.default_rng(0)), by_chance, names


def test_draws_of_variational_inference_have_the_error_that_is_theirs():
    """The closest independent normal density has the right mean, sds of √(1 − ρ²), and no correlation."""
    rho = 0.45
    precision = np.linalg.inv([[1.0, rho], [rho, 1.0]])
    draws = np.sqrt(1.0 - rho**2) * np.random.default_rng(4).normal(size=(6000, 2))
    test, by_chance, names = examined(lambda x: -0.5 * np.einsum("...i,ij,...j", x, precision, x), draws)
    of_sd, of_correlation = np.sqrt(1.0 - rho**2) - 1.0, -rho
    chance = 4.0 / np.sqrt(2.0 * 6000)
    assert test.deviation.sd == pytest.approx([of_sd, of_sd], abs=chance)
    assert test.deviation.correlation[0, 1] == pytest.approx(of_correlation, abs=2.0 * chance)
    assert "correlation of x0 and x1" in test.doubts(si.Limits(), names)[0]
    wide = si.Limits(mean=0.3, sd=0.3, correlation=0.8)
    added = test.added_to(by_chance)
    assert added.sd.max() > 0.09 > by_chance.sd.max()
    assert added.of_probability(0.05) > 0.005
    assert not any("averages" in doubt for doubt in test.doubts(wide, names))


def test_good_draws_of_a_bent_density_raise_no_doubt():
    rng = np.random.default_rng(5)
    along = rng.normal(size=6000)
    draws = np.stack([along, rng.normal(along**2, 0.5)], axis=1)
    bent = examined(lambda x: -0.5 * x[..., 0] ** 2 - 2.0 * (x[..., 1] - x[..., 0] ** 2) ** 2, draws)
    assert bent[0].doubts(si.Limits(), bent[2]) == ()


def test_differences_that_overflow_leave_the_draws_undecided():
    small, unknown = np.zeros(2), np.full(2, np.nan)
    test = SteinTest(
        Deviation(unknown, small, np.zeros((2, 2))),
        Deviation(unknown, small, np.zeros((2, 2))),
        0.0,
        0.0,
        moment_probability=1e-4,
        kernel_probability=0.5,
        effective_share=1.0,
    )
    (doubt,) = test.doubts(si.Limits(), ("a", "b"))
    assert "cannot decide" in doubt and "the mean of a may be wrong by more than 10" in doubt


def test_a_surrogate_that_leaves_few_draws_decides_nothing():
    test = SteinTest(*2 * (Deviation(np.ones(1), np.ones(1), np.zeros((1, 1))),), 1.0, 1.0, 1e-4, 1e-4, 0.1)
    (doubt,) = test.doubts(si.Limits(), ("a",))
    assert "cannot decide" in doubt and "at only 10.0% of the draws" in doubt


def test_fewer_draws_than_the_surrogate_takes_are_divided():
    test, _, names = examined(lambda x: -0.5 * (x**2).sum(axis=-1), np.random.default_rng(6).normal(size=(120, 2)))
    assert "cannot decide" in "".join(test.doubts(si.Limits(mean=0.001), names))
