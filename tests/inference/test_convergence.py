"""Diagnostics: times of known processes, ensembles that disagree, walkers that are stuck."""

import numpy as np
import pytest
import scipy.signal
import scipy.special
import scipy.stats

import structid as si
from structid.inference import convergence as diagnostics
from structid.inference.diagnostics import verdict


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 0.97])
def test_autocorrelation_time_of_an_ar1_process(rho):
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((4, 60_000))
    series = scipy.signal.lfilter([1.0], [1.0, -rho], noise, axis=1)
    assert diagnostics.autocorrelation_time(series) == pytest.approx((1 + rho) / (1 - rho), rel=0.12)


def test_r_hat_sees_ensembles_that_disagree():
    rng = np.random.default_rng(2)
    same = rng.standard_normal((400, 4, 20))
    apart = same + np.array([0.0, 0.0, 0.0, 0.4])[None, :, None]
    assert diagnostics.r_hat(same) < 1.01 < diagnostics.r_hat(apart)
    assert np.isnan(diagnostics.r_hat(same[:, :1]))


def test_stuck_walkers_are_found():
    rng = np.random.default_rng(3)
    accepted, density = rng.random((500, 2, 20)) < 0.4, -0.5 * rng.chisquare(5, (500, 2, 20))
    assert not diagnostics.stuck_walkers(accepted, density).any()
    density[:, 1, 7] -= 300.0
    accepted[:, 0, 3] = False
    stuck = diagnostics.stuck_walkers(accepted, density)
    assert stuck[1, 7] and stuck[0, 3] and stuck.sum() == 2


def test_short_chains_are_judged_by_their_walkers():
    """Twenty steps of AR(1) walkers with φ = 0.9, τ = 19: the mean over each ensemble, about its own mean, would say 3 or so."""
    from structid.inference.convergence import autocorrelation_time, series_time

    rng = np.random.default_rng(1)
    draws = np.empty((20, 4, 400))
    draws[0] = rng.normal(size=(4, 400))
    for t in range(1, 20):
        draws[t] = 0.9 * draws[t - 1] + np.sqrt(1.0 - 0.81) * rng.normal(size=(4, 400))
    assert autocorrelation_time(draws.mean(axis=2).T) < 6.0 < series_time(draws)


def handed_on(seed, steps, walkers, rho):
    """Walkers that take over their places, x_i(t) = ρ x_{i−1}(t−1) + noise: each alone looks independent, their mean is not."""
    rng, shape = np.random.default_rng(seed), (4, walkers)
    draws = np.empty((steps, *shape))
    draws[0] = rng.standard_normal(shape)
    for t in range(1, steps):
        draws[t] = rho * np.roll(draws[t - 1], 1, axis=1) + np.sqrt(1.0 - rho**2) * rng.standard_normal(shape)
    return draws


def test_the_time_of_an_ensemble_that_moves_together_is_that_of_its_mean():
    rho = 0.9
    draws = handed_on(6, 4000, 60, rho)
    assert diagnostics.autocorrelation_time(draws.reshape(4000, -1).T) < 1.5
    assert diagnostics.series_time(draws) == pytest.approx((1 + rho) / (1 - rho), rel=0.3)


def test_a_chain_too_short_to_tell_is_not_called_long_enough():
    """Of 65 steps with τ = 66 the means cannot say how much of theirs is noise, so the longer one judges the length."""
    draws = handed_on(9, 65, 32, 0.97)
    assert diagnostics.series_time(draws) < 3.0
    figures = diagnostics.parameter_diagnostics(draws)
    assert figures.autocorrelation_time > 13.0
    failures = verdict.convergence_failures({"a": figures}, 65, 4, 0, si.DelayedAcceptance.needed_length)
    assert any("autocorrelation times of a" in failure for failure in failures)


def test_the_time_of_a_constant_is_none():
    with np.errstate(all="raise"):
        assert np.isnan(diagnostics.series_time(np.full((37, 3, 7), 0.1)))
        assert np.isnan(diagnostics.longest_time(np.full((37, 3, 7), 0.1)))


def test_the_time_of_few_steps_is_known():
    """AR(1) walkers, ρ = 0.9, of 100 steps: the means of four ensembles know τ to 40 %, the walkers to 10 %."""
    rng, rho, by_means, by_walkers = np.random.default_rng(7), 0.9, [], []
    for _ in range(60):
        start = rho * rng.normal(size=(1, 4, 32))
        noise = np.sqrt(1.0 - rho**2) * rng.standard_normal((100, 4, 32))
        draws = scipy.signal.lfilter([1.0], [1.0, -rho], noise, axis=0, zi=start)[0]
        by_means.append(diagnostics.autocorrelation_time(draws.mean(axis=2).T))
        by_walkers.append(diagnostics.series_time(draws))
    assert np.std(by_walkers) / np.mean(by_walkers) < 0.15 < 0.3 < np.std(by_means) / np.mean(by_means)


def test_few_steps_do_not_make_a_walker_stuck():
    from structid.inference.convergence import stuck_walkers

    rng = np.random.default_rng(2)
    density = -0.5 * rng.chisquare(5, size=(8, 4, 32))
    assert not stuck_walkers(rng.random((8, 4, 32)) < 0.3, density).any()
    density[:, 1, 7] -= 60.0
    assert stuck_walkers(rng.random((8, 4, 32)) < 0.3, density).sum() == 1


@pytest.mark.parametrize("steps", [50, 100, 2000])
def test_short_series_do_not_hide_their_correlation(steps):
    """AR(1) walkers, ρ = 0.9: the variance of their mean is σ² (1 + 2 Σ (1 − t/S) ρᵗ) / N, whatever the length of the series."""
    rng, rho, found = np.random.default_rng(5), 0.9, []
    for _ in range(60 if steps < 1000 else 6):
        noise = rng.standard_normal((steps, 4, 20))
        draws = scipy.signal.lfilter(
            [np.sqrt(1 - rho**2)], [1.0, -rho], noise, axis=0, zi=rho * rng.normal(size=(1, 4, 20))
        )[0]
        found.append(1.0 / diagnostics.effective_sample_size(draws))
    lags = np.arange(1, steps)
    time = 1.0 + 2.0 * np.sum((1.0 - lags / steps) * rho**lags)
    error = np.std(found) / np.sqrt(len(found))
    # Sokal's window leaves out a few hundredths of the sum.
    assert abs(np.mean(found) * steps * 80 / time - 0.97) < 0.05 + 4.0 * error * steps * 80 / time


@pytest.mark.parametrize("seed", range(5))
def test_chains_that_stop_short_of_a_tail_disagree_with_a_population(seed):
    """A Cauchy of which the chains never see what lies beyond 20: a share of 0.03; and chains that see all of it."""
    rng = np.random.default_rng(seed)
    beside = rng.standard_cauchy((20, 8, 250, 1))
    whole = rng.standard_cauchy((1000, 4, 1, 1))
    short = whole[np.abs(whole[:, 0, 0, 0]) < 20.0]
    cut = np.concatenate([np.where(np.abs(whole) < 20.0, whole, rng.normal(size=whole.shape))])
    assert len(short) < len(whole)
    assert verdict.disagreements(("x",), whole, beside) == []
    said = verdict.disagreements(("x",), cut, beside)
    assert len(said) == 1 and "quantile of x" in said[0] and "tail" in said[0]


def test_chains_in_one_of_two_modes_disagree_with_a_population():
    rng = np.random.default_rng(1)
    beside = rng.normal(size=(20, 8, 250, 1)) + 8.0 * rng.integers(0, 2, (1, 8, 250, 1))
    said = verdict.disagreements(("x",), rng.normal(size=(1000, 4, 1, 1)), beside)
    assert len(said) == 1 and "x" in said[0]


def test_particles_in_a_heavy_tail_are_not_stuck():
    """They are where the weights put them; a tail is left as slowly as it is entered."""
    space = si.ParameterSpace(x=si.Normal(0.0, 50.0), y=si.Normal(0.0, 50.0))
    target = si.LogDensity(lambda x: -1.2 * np.log1p((x**2).sum(axis=1)), space.names, space)
    for seed in range(3):
        assert si.sample(target, si.SMC(particles=300, steps=20), seed=seed).verdict().stuck == 0
