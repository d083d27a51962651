"""The Monte Carlo error of draws: it covers the true moments as often as it says, for chains, walkers in turn and heavy tails."""

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from structid.certification.limits import Limits
from structid.certification.monte_carlo_error import MonteCarloError
from structid.inference.convergence import walkers_in_turn

REPETITIONS = 300
RHO = 0.6
MIXING = np.linalg.cholesky(np.array([[1.0, RHO], [RHO, 1.0]]))


def independent(rng):
    return rng.standard_normal((4, 1000, 2)) @ MIXING.T


def autoregressive(rng):
    """Eight chains of 1000 steps with τ = 9."""
    noise = 0.6 * rng.standard_normal((8, 1200, 2))
    return scipy.signal.lfilter([1.0], [1.0, -0.8], noise, axis=1)[:, 200:] @ MIXING.T


def student(rng):
    """Nine degrees of freedom, and a Gaussian copula: the kurtosis is 4.2."""
    normal = rng.standard_normal((4, 2000, 2)) @ MIXING.T
    return normal / np.sqrt(rng.chisquare(9.0, (4, 2000, 1)) / 9.0) / np.sqrt(9.0 / 7.0)


@pytest.mark.parametrize("sampler", [independent, autoregressive, student])
def test_it_covers_as_often_as_it_says(sampler):
    """With 95 %, within three errors of as many repetitions; it is not so large that it would always do."""
    covered, rng = np.zeros(3), np.random.default_rng(1)
    for _ in range(REPETITIONS):
        draws = sampler(rng)
        found, flat = MonteCarloError.of(draws, 0.95), draws.reshape(-1, 2)
        covered[0] += np.all(np.abs(flat.mean(axis=0)) <= found.mean)
        covered[1] += np.all(np.abs(flat.std(axis=0) - 1.0) <= found.sd)
        covered[2] += abs(np.corrcoef(flat.T)[0, 1] - RHO) <= found.correlation[0, 1]
    error = np.sqrt(0.95 * 0.05 / REPETITIONS)
    # The larger of two estimates of an error is above it on average.
    assert np.all(covered / REPETITIONS > 0.95 - 3.0 * error) and np.all(covered / REPETITIONS < 0.995), covered


def test_a_certificate_of_other_moments_than_it_covers_fails():
    """Half of the intervals are no longer wide enough."""
    rng, covered = np.random.default_rng(2), 0
    for _ in range(REPETITIONS):
        draws = independent(rng)
        covered += np.all(np.abs(draws.mean(axis=(0, 1))) <= 0.5 * MonteCarloError.of(draws, 0.95).mean)
    assert covered / REPETITIONS < 0.85


def test_walkers_in_turn():
    rng = np.random.default_rng(3)
    chains = autoregressive(rng)
    in_turn = chains.swapaxes(0, 1).reshape(-1, 2)
    assert walkers_in_turn(in_turn) == 8
    slow = scipy.signal.lfilter([1.0], [1.0, -0.99], rng.standard_normal((4000, 2)), axis=0)
    for one in (chains[0], rng.permutation(in_turn), slow, independent(rng).reshape(-1, 2)):
        assert walkers_in_turn(one) == 1


def test_too_few_draws_are_told():
    few = np.random.default_rng(4).standard_normal((1, 200, 2)).reshape(4, 50, 2)
    (said,) = MonteCarloError.of(few, 0.95).too_large(Limits(), ("a", "b"))
    assert "there are too few draws" in said and "independent draws" in said and "times as many" in said
    assert MonteCarloError.of(few, 0.95).too_large(Limits(mean=0.5, sd=0.5, correlation=0.5), ("a", "b")) == ()
