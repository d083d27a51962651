"""Whitened residuals and robust standard deviations: right where the law is right, wider where it is not."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from structid.inference.assessment.residuals import (
    WhitenedResidual,
    autocovariance,
    long_run_covariance,
    parzen,
    robust_covariance,
    whitened_residuals,
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


@pytest.mark.slow
def test_robust_and_plain_agree_where_the_law_is_right_and_not_where_it_is_wrong(short_posterior):
    """The same oscillator, measured with white noise and with AR(1) noise: scatter of the estimate is √((1+φ)/(1−φ)) wider."""
    observation = short_posterior.observations[0]
    theta = np.array([[7.0e6, 60.0, 0.3, 0.06]])
    clean = short_posterior.model.simulate(theta, observation.record).values[0, :, 0]
    sd = 0.1 * clean.std()
    ratios = {}
    for kind in ("white", "correlated"):
        found = []
        for seed in range(4):
            rng = np.random.default_rng(seed)
            noise = rng.normal(size=len(clean)) if kind == "white" else ar1(rng, len(clean))
            posterior = si.Posterior(
                short_posterior.model_space,
                short_posterior.model,
                si.Observation(observation.record, clean + sd * noise),
                si.IID(variance=float(sd**2)),
            )
            result = si.sample(posterior, SMC, seed=seed)
            found.append((result.robust_sd / result.sd)[0])  # of the stiffness, which the data see best
            correlated = whitened_residuals(posterior, result.map_estimate)[0].correlated
            assert correlated == (kind == "correlated")
            told = [w for w in result.verdict().warnings if "independent errors" in w]
            assert len(told) == (kind == "correlated") and all("damped_cosine" in w for w in told)
        ratios[kind] = float(np.sqrt(np.mean(np.square(found))))
    # Four estimates, each good to a fifth or so; below one, since the prior's part of the information does not scatter.
    assert 0.5 < ratios["white"] < 1.4, ratios
    assert ratios["correlated"] > 1.7 * ratios["white"], ratios


def test_a_summary_has_robust_standard_deviations_in_its_units(short_posterior):
    result = si.sample(short_posterior, replace(SMC, steps=10), seed=1)
    column = result.summary().columns["robust_sd"]
    covariance = robust_covariance(short_posterior, result.thinned())
    np.testing.assert_allclose(column, np.sqrt(np.diag(covariance)) / short_posterior.factors)
    assert "robust_sd" not in si.sample(_bare(), replace(SMC, steps=10), seed=1).summary().columns


def _bare():
    return si.LogDensity(lambda t: -0.5 * (t**2).sum(axis=1), ("x",), si.ParameterSpace(x=si.Normal(0.0, 3.0)))
