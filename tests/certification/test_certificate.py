"""The certificate: what it lets pass and what it stops, by the power that its two sample sizes have; what it says."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from structid.certification.certificate import issue_certificate
from structid.certification.fresh_draws import FreshDraws, StoredRuns
from structid.certification.limits import Limits
from structid.certification.moment_bounds import correlation_bound
from structid.certification.weight_variation import WeightVariation
from structid.core.errors import InputError

pytestmark = pytest.mark.quick

PLAIN, TEMPERED, TAU = 20, 10, 0.5
POPULATION = np.random.default_rng(0).standard_normal((500, 10))


def drawn(log_weight, dimension=4, seed=0, plain=PLAIN, tempered=TEMPERED):
    """Fresh draws of q = N(0, I), a third of them of q^½, with log π/q as a function of them."""
    rng = np.random.default_rng(seed)
    wide = rng.standard_normal((tempered, dimension)) / np.sqrt(TAU)
    theta = np.concatenate([rng.standard_normal((plain, dimension)), wide])
    squares = (theta**2).sum(axis=1)
    log_drawn = -0.5 * squares
    mixed = plain + tempered * TAU ** (dimension / 2) * np.exp(0.5 * (1.0 - TAU) * squares)
    log_true = log_drawn + log_weight(theta, rng) + 17.0
    return FreshDraws(theta, theta, log_true, log_drawn, 1.0 / mixed, POPULATION[:, :dimension], -0.1)


def certified(log_weight, dimension=4, replications=200):
    """Share of certificates."""
    names = tuple(f"a{i}" for i in range(dimension))
    found = [issue_certificate(drawn(log_weight, dimension, s), StoredRuns(), names, 100) for s in range(replications)]
    return np.mean([c.certified for c in found])


def other_sd(factor):
    return lambda theta, rng: -0.5 * theta[:, 0] ** 2 * (factor**-2 - 1.0)


def tail(share, too_light):
    """The true law has so many times more density in the upper tail of q, which has a share of its probability."""
    edge = scipy.stats.norm.isf(share)
    return lambda theta, rng: np.where(theta[:, 0] > edge, np.log(too_light), 0.0)


def rough(spread):
    return lambda theta, rng: spread * rng.standard_normal(len(theta))


CORRELATED = 0.3


def ignored_correlation(theta, rng):
    x, y = theta[:, 0], theta[:, 1]
    return -0.5 * (x**2 - 2.0 * CORRELATED * x * y + y**2) / (1.0 - CORRELATED**2) + 0.5 * (x**2 + y**2)


PASS = {"weights of spread 1e-6": rough(1e-6), "equal weights": rough(0.0), "weights of spread 0.03": rough(0.03)}
STOP = {
    "sd 0.8": other_sd(0.8),
    "sd 1.2": other_sd(1.2),
    "mean off by 0.2 sd": lambda theta, rng: 0.2 * theta[:, 0],
    "correlation ignored": ignored_correlation,
}


@pytest.mark.parametrize("dimension", [4, 10])
@pytest.mark.parametrize("good", PASS)
def test_what_is_right_passes(good, dimension):
    """95 of 100, less three of their own Monte-Carlo errors."""
    least = 1.0 if good != "weights of spread 0.03" else 0.95
    assert certified(PASS[good], dimension) >= least - 3.0 * np.sqrt(least * (1.0 - least) / 200)


@pytest.mark.parametrize("dimension", [4, 10])
@pytest.mark.parametrize("bad", STOP)
def test_what_is_wrong_is_stopped(bad, dimension):
    assert certified(STOP[bad], dimension) <= 0.01 + 3.0 * np.sqrt(0.01 * 0.99 / 200)


@pytest.mark.parametrize("dimension", [4, 10])
def test_a_tail_that_is_ten_times_too_light(dimension):
    assert certified(tail(0.05, 10.0), dimension) <= 0.1 + 3.0 * np.sqrt(0.1 * 0.9 / 200)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.95])
def test_the_bound_of_a_correlation(rho):
    """Weights 1 + c f of the function f that moves it most: it is off by c sd(f), to first order, and χ = c sd(f)/sd(f)."""
    factor = np.linalg.cholesky([[1.0, rho], [rho, 1.0]])
    theta = np.random.default_rng(5).standard_normal((400_000, 2)) @ factor.T
    moving = theta[:, 0] * theta[:, 1] - 0.5 * rho * (theta**2).sum(axis=1)
    # In units of its standard deviation 1 − ρ², and cut off, so that no weight is negative.
    weights = 1.0 + np.clip(0.05 * moving / (1.0 - rho**2), -0.9, 0.9)
    weights /= weights.sum()
    mean = weights @ theta
    covariance = (weights[:, None] * (theta - mean)).T @ (theta - mean)
    off = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]) - rho
    variation = WeightVariation(0.05, 0.05, 0.95, 30.0)
    bound = correlation_bound(FreshDraws(theta, theta, theta[:, 0], theta[:, 0], theta[:, 0], theta, 0.0), variation)
    assert bound[0, 0] == bound[1, 1] == 0.0 and bound[0, 1] == bound[1, 0]
    assert 0.9 * bound[0, 1] < off + 0.05**2 < bound[0, 1] + 3.0 / np.sqrt(len(theta))


def test_correlations_of_a_parameter_without_spread():
    """As of one that a law knows: whatever the weights, an infinite bound is no NaN."""
    theta = np.random.default_rng(5).standard_normal((500, 2)) * np.array([1.0, 0.0])
    fresh = FreshDraws(theta, theta, theta[:, 0], theta[:, 0], theta[:, 0], theta, 0.0)
    assert correlation_bound(fresh, WeightVariation(0.05, 0.05, 0.95, 30.0))[0, 1] == 0.05**2
    assert correlation_bound(fresh, WeightVariation(np.inf, np.inf, 0.95, 30.0))[0, 1] == np.inf


def test_a_small_shift_is_told():
    one = issue_certificate(drawn(lambda theta, rng: 0.03 * theta[:, 0]), StoredRuns(), ("a", "b", "c", "d"), 99)
    assert one.certified and one.variation.estimate < one.variation.bound <= 0.1
    assert abs(one.shift[0] - 0.03) < 4.0 * one.shift_error[0] + 0.005
    told = str(one)
    assert "CERTIFIED (99 model runs, 30 of them at fresh draws)" in told and "not excluded" in told
    plain = one.to_plain()
    assert plain["verdict"] == "certified" and plain["variation"]["bound"] == one.variation.bound
    assert plain["unseen"] == pytest.approx(3.0 / one.variation.draws)


def test_looks_cost_confidence():
    """The same draws, looked at again and again: the bound rises, and all confidences together spend what there is."""
    weights = rough(0.05)
    bounds = [
        issue_certificate(drawn(weights), StoredRuns(), tuple("abcd"), 99, look).variation.bound for look in (1, 2, 3)
    ]
    assert bounds[0] < bounds[1] < bounds[2]
    assert sum(1.0 - Limits().confidence_of(look) for look in range(1, 40)) < 0.05 + 1e-12


def of_an_exponential_law(log_weight, seed, dimension=4, draws=(PLAIN, TEMPERED)):
    """Fresh draws of a q whose marginals are exponential, as of parameters whose posterior leans against a bound."""
    rng = np.random.default_rng(seed)
    theta = rng.standard_exponential((sum(draws), dimension))
    theta[draws[0] :] /= TAU
    mixed = draws[0] + draws[1] * TAU**dimension * np.exp((1.0 - TAU) * theta.sum(axis=1))
    log_drawn = -theta.sum(axis=1)
    many = np.random.default_rng(0).standard_exponential((20_000, dimension))
    return FreshDraws(theta, theta, log_drawn + log_weight(theta, rng), log_drawn, 1.0 / mixed, many, 0.0)


def long_tail(slope):
    """Weights w = 1 + c (z² − 1), which move the variance as far as weights of their variation can."""
    return lambda theta, rng: np.log1p(slope * ((theta[:, 0] - 1.0) ** 2 - 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("weight", "least", "most"),
    [
        (rough(0.03), 0.95, 1.0),
        (long_tail(0.026), 0.0, 0.05),
        (long_tail(0.04), 0.0, 0.05),
    ],
)
def test_sds_of_long_tails(weight, least, most):
    """Of c = 0.026 the variance is 21 % off and χ = 0.07 (κ = 9): its mean is fine, and its sd is 10 % off."""
    names, count = tuple("abcd"), 120
    found = [issue_certificate(of_an_exponential_law(weight, seed), StoredRuns(), names, 99) for seed in range(count)]
    share = np.mean([c.certified for c in found])
    assert least - 3.0 * np.sqrt(0.05 * 0.95 / count) <= share <= most + 3.0 * np.sqrt(0.05 * 0.95 / count)


def shifted(by):
    """The true density has one mean shifted by `by` standard deviations, and all standard deviations 2 % larger."""

    def log_weight(theta, rng):
        moved = theta - by * np.eye(theta.shape[1])[0]
        return 0.5 * (theta**2).sum(axis=1) - 0.5 * (moved**2).sum(axis=1) / 1.02**2

    return log_weight


@pytest.mark.parametrize("dimension", [4, 15])
def test_the_bound_of_a_mean_lies_above_the_truth(dimension):
    """Also by the draws alone, where it is far below χ; the estimate without its error is below the truth every second time."""
    names, by, count = tuple(f"a{i}" for i in range(dimension)), 0.05, 200
    population = np.random.default_rng(0).standard_normal((500, dimension))
    found = [
        issue_certificate(
            replace(drawn(shifted(by), dimension, s), population=population), StoredRuns(), names, 99, limits=Limits()
        )
        for s in range(count)
    ]
    bounds, shifts = (np.array([getattr(c, name)[0] for c in found]) for name in ("mean_bound", "shift"))
    assert np.mean(bounds > by) >= 0.95 - 3.0 * np.sqrt(0.05 * 0.95 / count)
    assert np.mean(np.abs(shifts) > by) < 0.7
    if dimension == 15:
        assert np.median(bounds) < 0.85 * np.median([c.variation.bound for c in found])


def test_a_refusal_says_how_many_draws_would_show_the_limits():
    """All standard deviations 2 % too small in 15 dimensions: within the limits, but not by 30 draws."""
    names = tuple(f"a{i}" for i in range(15))
    population = np.random.default_rng(0).standard_normal((500, 15))

    def judged(seed, plain, tempered):
        fresh = drawn(shifted(0.0), 15, seed, plain, tempered)
        return issue_certificate(replace(fresh, population=population), StoredRuns(), names, 99)

    few = [judged(seed, PLAIN, TEMPERED) for seed in range(20)]
    refused = [c for c in few if not c.certified]
    assert len(refused) > 10
    enough = int(np.median([c.enough for c in refused if c.enough]))
    assert 60 <= enough <= 240 and f"about {refused[0].enough} model runs" in str(refused[0])
    many = [judged(seed, 2 * enough // 3, enough // 3).certified for seed in range(20)]
    assert np.mean(many) > 0.7
    wrong = issue_certificate(drawn(other_sd(0.75)), StoredRuns(), tuple("abcd"), 99)
    assert not wrong.certified and wrong.enough is None and "would show" not in str(wrong)


def test_the_bound_of_an_sd_lies_above_the_truth():
    """And where the weights are as unequal in the middle as in the tail, below what χ alone says."""
    theta = np.random.default_rng(3).standard_exponential(1_000_000)
    weights = np.exp(long_tail(0.04)(theta[:, None], None))
    mean = weights @ theta / weights.sum()
    off = 1.0 - 1.0 / np.sqrt(weights @ (theta - mean) ** 2 / weights.sum())
    names = tuple("abcd")
    bounds = [
        issue_certificate(of_an_exponential_law(long_tail(0.04), s), StoredRuns(), names, 99).sd_bound[0]
        for s in range(100)
    ]
    assert np.mean(np.array(bounds) > off) >= 0.95 - 3.0 * np.sqrt(0.05 * 0.95 / 100)
    even = issue_certificate(of_an_exponential_law(rough(0.05), 1), StoredRuns(), names, 99)
    assert even.sd_bound.max() < 0.6 * (1.0 - np.sqrt(1.0 - even.variation.of_variance(np.array([9.0]))[0]))


@pytest.mark.parametrize(
    ("stored", "said"),
    [
        (StoredRuns(np.array([17.0 - 2.0, -50.0]), np.array([-60.0, -67.0])), "misses a part"),
        (StoredRuns(np.array([15.0, -85.0]), np.array([-2.0, -400.0])), "much too low at 1 stored model runs"),
        (StoredRuns(np.array([17.0 + 22.0]), np.array([22.0])), "22.1 nats above every draw"),
    ],
)
def test_mass_that_no_draw_visits(stored, said):
    """Whatever the weights of the draws say."""
    found = issue_certificate(drawn(rough(0.0)), stored, tuple("abcd"), 99)
    assert found.verdict == "not to be trusted" and said in str(found)


def test_stored_runs_that_are_as_they_should_be():
    fine = issue_certificate(
        drawn(rough(0.0)), StoredRuns(np.array([17.0 - 2.0, 18.0]), np.array([-4.9, 0.9])), tuple("abcd"), 99
    )
    assert fine.certified and fine.excess == pytest.approx(2.9) and fine.within_reach == 2


def test_a_variance_with_a_long_tail_is_compared_by_its_logarithm():
    """Of a variance v with the density v⁻², as of one that is hardly known, the logarithm is exponential.

    It has no standard deviation itself: whether one of the draws falls far into the tail decides what is said of it.
    """
    bounds = []
    for seed in range(20):
        fresh = of_an_exponential_law(rough(0.02), seed, dimension=1)
        itself = replace(fresh, compared=np.exp(fresh.theta), population=np.exp(fresh.population))
        found = [issue_certificate(one, StoredRuns(), ("log sigma2",), 99) for one in (fresh, itself)]
        assert found[0].certified and "for error variances, this refers to the logarithm" in found[0].statement
        bounds.append([one.sd_bound[0] for one in found])
    of_logarithm, of_itself = np.transpose(bounds)
    assert of_logarithm.max() < 0.04 and of_itself.max() > 0.5 and of_itself.min() < 0.01


def test_a_failed_true_run_is_not_certified():
    fresh = drawn(rough(0.0))
    log_true = np.where(np.arange(30) == 7, -np.inf, fresh.log_true)
    rest = (fresh.log_drawn, fresh.shares, fresh.population, fresh.highest)
    found = issue_certificate(FreshDraws(fresh.theta, fresh.theta, log_true, *rest), StoredRuns(), tuple("abcd"), 99)
    assert found.verdict == "not to be trusted" and found.failed == 1 and found.weights[7] == 0.0
    # A structure that fails is an answer: the draw weighs nothing, and the others more.
    collapsed = FreshDraws(fresh.theta, fresh.theta, log_true, *rest, np.arange(30) == 7)
    found = issue_certificate(collapsed, StoredRuns(), tuple("abcd"), 99)
    assert found.failed == 0 and found.variation.estimate > 0.1 and not found.certified


def test_moments_that_weights_can_mend():
    """Many draws of a law that is too wide: not certified, and re-weighted it is the true one."""
    found = issue_certificate(drawn(other_sd(0.75), plain=400, tempered=200), StoredRuns(), tuple("abcd"), 700)
    assert found.verdict == "usable with re-weighting"
    sd = np.sqrt(found.weights @ found.draws**2)
    np.testing.assert_allclose(sd, [0.75, 1.0, 1.0, 1.0], rtol=0.15)


def test_too_few_draws():
    with pytest.raises(InputError, match="12 fresh draws"):
        issue_certificate(drawn(rough(0.0), plain=8, tempered=4), StoredRuns(), tuple("abcd"), 99)
