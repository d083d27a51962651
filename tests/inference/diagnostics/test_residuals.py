"""Whitened residuals and robust standard deviations: right where the law is right, wider where it is not."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from structid.inference.convergence import autocovariance
from structid.inference.diagnostics.residuals import WhitenedResidual, residual_warnings, whitened_residuals
from structid.inference.diagnostics.robust_spread import (
    LONG_RUN_SHARE,
    RobustSpread,
    _traces,
    long_run_covariance,
    parzen,
    robust_spread,
)

PHI = 0.9
SMC = si.SMC(particles=100, steps=20, effective_share=0.5, correlation=0.4)


def ar1(rng, samples):
    noise = np.empty(samples)
    noise[0] = rng.normal()
    for t in range(1, samples):
        noise[t] = PHI * noise[t - 1] + np.sqrt(1 - PHI**2) * rng.normal()
    return noise


def test_the_long_run_covariance_is_the_weighted_sum_of_all_pairs():
    series = np.random.default_rng(1).normal(size=(120, 2))
    centred = series - series.mean(axis=0)
    lags = np.abs(np.subtract.outer(np.arange(120), np.arange(120)))
    expected = centred.T @ parzen(lags / 20.0) @ centred / (1.0 - 0.75 / 6.0)
    np.testing.assert_allclose(long_run_covariance(series), expected, rtol=1e-9)
    np.testing.assert_allclose(np.diag(np.cov(series.T, ddof=0)) * 120, autocovariance(series)[0])


def test_the_long_run_covariance_of_known_processes():
    """White noise and AR(1): variance of the sum, within 4 sd of its mean over 400 series."""
    rng = np.random.default_rng(2)
    for make, truth in ((lambda: rng.normal(size=1500), 1.0), (lambda: ar1(rng, 1500), (1 + PHI) / (1 - PHI))):
        found = np.array([long_run_covariance(make()[:, None])[0, 0] for _ in range(400)]) / 1500 / truth
        bias = 0.03 if truth == 1.0 else 0.08  # a window of a sixth of the series still cuts a little
        assert abs(found.mean() - 1.0) < bias + 4.0 * found.std() / 20.0


def test_what_white_and_correlated_residuals_say():
    rng = np.random.default_rng(3)
    white = WhitenedResidual("velocity", "a record", 0.01, rng.normal(size=2000))
    assert not white.correlated and abs(white.autocorrelation[1:]).max() < white.bound
    frequency, power = white.spectrum
    assert power.mean() == pytest.approx(1.0, abs=0.15) and frequency[-1] == pytest.approx(50.0)
    narrow = WhitenedResidual("velocity", "a record", 0.01, np.sin(2 * np.pi * 4.0 * 0.01 * np.arange(2000)))
    assert narrow.correlated and abs(narrow.largest[0]) > 0.9
    assert narrow.spectrum[0][np.argmax(narrow.spectrum[1])] == pytest.approx(4.0, abs=0.3)


def test_all_channels_are_warned_of_in_one_sentence():
    """Four sensors whose errors are no white noise are one fault, not four."""
    rng = np.random.default_rng(4)
    slow = [WhitenedResidual(f"drift_{k}", "a record", 0.01, ar1(rng, 2000)) for k in (1, 2, 3)]
    white = WhitenedResidual("velocity", "a record", 0.01, rng.normal(size=2000))
    [said] = residual_warnings((*slow, white), si.IID(), {"stiffness": 3.0, "alpha": 1.0})
    for k in (1, 2, 3):
        assert said.count(f"drift_{k} on a record by 0.") == 1
    assert "velocity" not in said and said.count("sd of stiffness is about 3 times too small") == 1
    assert said.count("use a correlated error model") == 1
    assert residual_warnings((white,), si.IID(), None) == []


def measured_with(noise, short_posterior):
    """The oscillator measured with noise of a tenth of its RMS, taken for independent."""
    observation = short_posterior.observations[0]
    clean = short_posterior.model.simulate(np.array([[7.0e6, 60.0, 0.3, 0.06]]), observation.record).values[0, :, 0]
    sd = 0.1 * clean.std()
    measurement = si.Observation(observation.record, clean + sd * noise(len(clean)))
    return si.Posterior(short_posterior.model_space, short_posterior.model, measurement, si.IID(variance=float(sd**2)))


@pytest.mark.slow
def test_robust_and_plain_agree_where_the_law_is_right_and_not_where_it_is_wrong(short_posterior):
    """White noise, and AR(1) noise, whose power at the frequency f of the oscillator is (1 − φ²)/(1 − 2φ cos 2πf dt + φ²)."""
    ratios = {}
    for kind in ("white", "correlated"):
        found = []
        for seed in range(4):
            rng = np.random.default_rng(seed)
            posterior = measured_with(
                rng.standard_normal if kind == "white" else lambda n, r=rng: ar1(r, n), short_posterior
            )
            result = si.sample(posterior, SMC, seed=seed)
            found.append((result.robust_sd / result.sd)[0])  # of the stiffness, which the data see best
            correlated = whitened_residuals(posterior, result.map_estimate)[0].correlated
            assert correlated == (kind == "correlated")
            told = [w for w in result.verdict().wrong_error_model if "independent errors" in w]
            assert len(told) == (kind == "correlated") and all("damped_cosine" in w for w in told)
        ratios[kind] = float(np.sqrt(np.mean(np.square(found))))
    frequency, dt = np.sqrt(7.0e6 / 12_000.0) / (2.0 * np.pi), short_posterior.observations[0].record.dt
    expected = np.sqrt((1.0 - PHI**2) / (1.0 - 2.0 * PHI * np.cos(2.0 * np.pi * frequency * dt) + PHI**2))
    # White residuals leave the posterior's own. The others are known to a fifth each, four of them to a tenth.
    assert ratios["white"] == 1.0 and abs(ratios["correlated"] / expected - 1.0) < 0.3, (ratios, expected)


def test_traces_are_those_of_the_matrices():
    """Written out: D = C W C over its norm, tr D diag(p) and tr (D diag(p))²."""
    rng, samples = np.random.default_rng(4), 90
    lags = np.abs(np.subtract.outer(np.arange(samples), np.arange(samples)))
    centring = np.eye(samples) - 1.0 / samples
    matrix = centring @ parzen(lags / (LONG_RUN_SHARE * samples)) @ centring / (1.0 - 0.75 * LONG_RUN_SHARE)
    power = rng.random((samples, 2))
    trace, square = _traces(power)
    for column in range(2):
        product = matrix @ np.diag(power[:, column])
        np.testing.assert_allclose(trace[column], np.trace(product), rtol=1e-9)
        np.testing.assert_allclose(square[column], np.trace(product @ product), rtol=1e-9)


@pytest.mark.slow
def test_the_expectation_is_corrected_where_the_noise_is_white(short_posterior):
    """Twenty measurements with a right model: the mean of the variances' ratios is one within four of its own errors."""
    observation, model = short_posterior.observations[0], short_posterior.model
    theta = np.array([[7.0e6, 60.0, 0.3, 0.06]])
    clean = model.simulate(theta, observation.record).values[0, :, 0]
    sd, corrected, plain, claimed = 0.05 * clean.std(), [], [], []
    for seed in range(20):
        noisy = clean + sd * np.random.default_rng(seed).normal(size=len(clean))
        wide = si.ParameterSpace(stiffness=si.Uniform(5.0, 9.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0))
        fixed = model.fixed(beta=60.0, alpha=0.06)
        of = si.Posterior(wide, fixed, si.Observation(observation.record, noisy), si.IID(variance=float(sd**2)))
        result = si.sample(of, replace(SMC, particles=400), seed=seed)
        found = robust_spread(of, result.thinned())
        corrected.append((found.sd / result.sd) ** 2)
        claimed.append(found.error)
        centred = result.thinned() - result.thinned().mean(axis=0)
        pointwise = of.pointwise_log_likelihood(result.thinned()).sum(axis=2)
        psi = (pointwise - pointwise.mean(axis=0)).T @ centred / len(centred)
        plain.append(np.diag(long_run_covariance(psi)) / result.sd**2)
    corrected, plain, claimed = map(np.array, (corrected, plain, claimed))
    error = corrected.std(axis=0, ddof=1) / np.sqrt(20)
    assert (np.abs(corrected.mean(axis=0) - 1.0) < 4.0 * error + 0.05).all(), corrected.mean(axis=0)
    assert (plain.mean(axis=0) < corrected.mean(axis=0)).all()
    # What it says of its own error is what it scatters by, within a factor of two: twenty know it to a sixth.
    scatter = np.sqrt(corrected).std(axis=0, ddof=1)
    assert (claimed.mean(axis=0) / scatter < 2.0).all() and (claimed.mean(axis=0) / scatter > 0.5).all()


def test_a_robust_sd_is_never_below_the_posterior_s_own():
    spread = RobustSpread(np.array([1.0, 3.0]), np.array([0.2, 0.3])).at_least(np.array([2.0, 2.0]))
    np.testing.assert_array_equal(spread.sd, [2.0, 3.0])
    np.testing.assert_array_equal(spread.error, [0.0, 0.3])


def test_a_summary_has_robust_standard_deviations_in_its_units_once_it_has_converged(short_posterior):
    posterior = measured_with(lambda n: ar1(np.random.default_rng(1), n), short_posterior)
    result = si.sample(posterior, SMC, seed=1)
    assert result.verdict().converged, str(result.verdict())
    column = result.summary().columns["robust_sd"]
    np.testing.assert_allclose(column, result.robust.sd / short_posterior.factors[:4])
    assert (result.robust.sd >= result.sd).all() and (result.robust.sd > result.sd).any()
    short = si.sample(posterior, replace(SMC, steps=2), seed=1)
    assert not short.verdict().converged and short.robust is None and "robust_sd" not in short.summary().columns
    assert "robust_sd" not in si.sample(_bare(), replace(SMC, steps=10), seed=1).summary().columns


def _bare():
    return si.LogDensity(lambda t: -0.5 * (t**2).sum(axis=1), ("x",), si.ParameterSpace(x=si.Normal(0.0, 3.0)))


def test_a_peak_of_the_spectrum_is_told_of_where_no_correlation_is_large():
    """White noise has none; a little narrow-band noise beside it has one, at its frequency."""
    from structid.inference.diagnostics.residuals import UNEVEN, WhitenedResidual

    rng, time = np.random.default_rng(1), 0.01 * np.arange(4001)
    for seed in range(20):
        white = WhitenedResidual("velocity", "r", 0.01, np.random.default_rng(seed).normal(size=4001))
        assert white.peak[1] < UNEVEN and not white.correlated
    phase = 2.0 * np.pi * 3.6 * time + np.cumsum(0.1 * rng.normal(size=time.size))
    tone = WhitenedResidual("velocity", "r", 0.01, rng.normal(size=4001) + 0.35 * np.cos(phase))
    assert tone.peak[1] > UNEVEN and tone.peak[0] == pytest.approx(3.6, abs=0.3) and not tone.correlated


def test_heavy_tails_and_uneven_errors_are_seen_and_not_imagined():
    """Student's t with ν = 3 and a proportional error in every series; white normal noise in none of 200."""
    response = np.sin(0.05 * np.arange(1500)) * np.exp(-((np.arange(1500) / 500.0) ** 2))
    for seed in range(200):
        rng = np.random.default_rng(seed)
        white = WhitenedResidual("velocity", "r", 0.01, rng.normal(size=1500), response=response)
        assert white.as_assumed, seed
        if seed >= 20:
            continue
        heavy = WhitenedResidual("velocity", "r", 0.01, rng.standard_t(3, size=1500) / np.sqrt(3.0), response=response)
        grown = (0.3 + np.abs(response) / response.std()) * rng.normal(size=1500)
        uneven = WhitenedResidual("velocity", "r", 0.01, grown / grown.std(), response=response)
        assert heavy.may_be_heavy_tailed and not heavy.uneven and uneven.uneven and uneven.may_be_uneven
    said = residual_warnings((heavy, uneven), si.IID(), {"stiffness": 3.0})
    assert "use the error model student" in " ".join(said) and "use the error model proportional" in said[-1]
    assert "sd of stiffness is about 3 times too small" in said[-1]


def test_the_periodogram_tells_white_noise_from_correlated_noise():
    """White noise fails at its level of 5 %, within four errors over 400 series; AR(1) noise with φ = 0.15 always fails."""
    white, correlated = [], []
    for seed in range(400):
        noise = np.random.default_rng(seed).normal(size=1500)
        white.append(WhitenedResidual("velocity", "r", 0.01, noise).is_white)
        if seed < 50:
            correlated.append(WhitenedResidual("velocity", "r", 0.01, noise[1:] + 0.15 * noise[:-1]).is_white)
    failed = 1.0 - np.mean(white)
    assert abs(failed - 0.05) < 4.0 * np.sqrt(0.05 * 0.95 / 400) and not any(correlated)
