"""Student's, proportional and rounded errors: special functions, grids, posteriors, and their choice by the data."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.core.errors import InputError
from structid.inference.error_models.outliers import _log_gamma
from structid.inference.error_models.quantised import _log_normal_tail, grid_step

SPACE = si.ParameterSpace(
    stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
)
MODEL = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=SPACE.names, substeps=1)
RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(1.8)
TRUTH = np.array([[7.2e6, 0.4]])
CLEAN = MODEL.simulate(TRUTH, RECORD).values[0, :, 0]
SD = 0.02 * CLEAN.std()


def normal(seed=1):
    return np.random.default_rng(seed).normal(size=CLEAN.shape)


def outliers():
    return CLEAN + SD * normal() * np.where(np.random.default_rng(2).random(CLEAN.shape) < 0.02, 30.0, 1.0)


def heavy():
    return CLEAN + SD * np.random.default_rng(2).standard_t(2.5, size=CLEAN.shape)


def proportional():
    return CLEAN * (1.0 + 0.1 * normal(3)) + 0.2 * SD * normal()


def rounded(bits=7):
    step = 2.0 * np.abs(CLEAN).max() / 2**bits
    return step * np.round(CLEAN / step)


def test_special_functions_against_scipy():
    x = np.exp(np.random.default_rng(0).uniform(-3.0, 6.0, 10_000))
    np.testing.assert_allclose(_log_gamma(x, np), scipy.special.gammaln(x), rtol=1e-12, atol=1e-12)
    x = np.concatenate([np.linspace(0.0, 40.0, 10_001), np.logspace(1, 7, 100)])
    np.testing.assert_allclose(_log_normal_tail(x, np), scipy.stats.norm.logsf(x), rtol=1e-13, atol=1e-9)


def test_densities_against_scipy():
    residual = 3.0 * np.random.default_rng(1).normal(size=(50, 1, 2))
    found = si.Student(variance=2.0, degrees_of_freedom=4.0).pointwise(residual, {}, ("velocity",), 0.01)
    np.testing.assert_allclose(found, scipy.stats.t.logpdf(residual, 4.0, scale=np.sqrt(2.0)), rtol=1e-12)
    mixture = si.Contaminated(variance=2.0, outlier_share=0.1, outlier_scale=5.0)
    usual, large = (scipy.stats.norm.pdf(residual, scale=scale) for scale in (np.sqrt(2.0), np.sqrt(50.0)))
    found = mixture.pointwise(residual, {}, ("velocity",), 0.01)
    np.testing.assert_allclose(found, np.log(0.9 * usual + 0.1 * large), rtol=1e-12)
    usual, large = (scipy.stats.norm.pdf(residual, scale=scale) for scale in (np.sqrt(5.0), np.sqrt(53.0)))
    found = mixture.log_likelihood(residual, {}, ("velocity",), 0.01, white=3.0)
    np.testing.assert_allclose(found, np.log(0.9 * usual + 0.1 * large).sum(axis=(0, 1)), rtol=1e-12)
    cell = scipy.stats.norm.cdf(residual + 1.0, scale=3.0) - scipy.stats.norm.cdf(residual - 1.0, scale=3.0)
    found = si.Quantised(variance=9.0, resolution=2.0).pointwise(residual, {}, ("velocity",), 0.01, response=residual)
    np.testing.assert_allclose(found, np.log(cell / 2.0), atol=1e-8)


def test_a_grid_is_found_where_there_is_one():
    values = np.random.default_rng(0).normal(size=500)
    assert grid_step(0.013 * np.round(values / 0.013) + 0.4) == pytest.approx(0.013, rel=1e-9)
    assert grid_step(values) is None and grid_step(np.zeros(20)) is None
    with_gap = np.where(np.arange(500) % 7 == 0, np.nan, 0.5 * np.round(values / 0.5))
    assert grid_step(with_gap) == pytest.approx(0.5)
    observation = si.Observation(RECORD, CLEAN)
    with pytest.raises(InputError, match="do not lie on a grid"):
        si.Posterior(SPACE, MODEL, observation, si.Quantised())


@pytest.mark.parametrize(
    ("error_model", "values"),
    [
        (si.Student(), outliers),
        (si.Contaminated(), outliers),
        (si.Proportional(), proportional),
        (si.Quantised(), rounded),
    ],
    ids=["student", "contaminated", "proportional", "quantised"],
)
class TestPosterior:
    def test_compiled_lanes_and_given_responses_agree(self, error_model, values):
        """The loop over samples in vector code, and the density of histories that are already there."""
        posterior = si.Posterior(SPACE, MODEL, si.Observation(RECORD, values()), error_model)
        theta = posterior.space.sample(40, seed=1).values
        assert posterior.in_lanes
        responses = MODEL.simulate(theta[:, :2], RECORD).values
        found = posterior.log_density(theta)
        np.testing.assert_allclose(posterior.given([responses]).log_density(theta), found, rtol=1e-9)
        pointwise = posterior.pointwise_log_likelihood(theta).sum(axis=(1, 2)) + posterior.space.log_density(theta)
        np.testing.assert_allclose(pointwise, found, rtol=1e-9)

    def test_the_truth_lies_in_the_posterior(self, error_model, values):
        """And the posterior is narrower than that of independent normal errors."""
        observation = si.Observation(RECORD, values())
        sampler = si.SMC(particles=200, steps=20)
        result, plain = (
            si.sample(si.Posterior(SPACE, MODEL, observation, each), sampler, seed=1)
            for each in (error_model, si.IID())
        )
        assert (np.abs(result.mean[:2] - TRUTH[0]) < 3.5 * result.sd[:2]).all()
        assert (result.sd[:2] < 0.7 * plain.sd[:2]).all()
        assert result.log_evidence.value > plain.log_evidence.value + 50.0


CASES = {
    "white": (lambda: CLEAN + SD * normal(), "iid"),
    "outliers": (outliers, "contaminated"),
    "heavy tails": (heavy, "student"),
    "proportional": (proportional, "proportional"),
    "rounded": (rounded, "quantised"),
    "finely rounded": (lambda: np.round((CLEAN + SD * normal()) / (0.5 * SD)) * 0.5 * SD, "iid"),
}


@pytest.mark.parametrize("case", CASES)
def test_the_data_choose_the_error_model_of_their_noise(case):
    make, right = CASES[case]
    choice = si.choose_error_model(SPACE, MODEL, si.Observation(RECORD, make()), seed=1)
    assert choice.error_models[choice.chosen] == right, str(choice)
    assert choice.error_models[0] == "iid" and "ar1" not in choice.error_models  # white residuals: nothing correlated
    assert not choice.result.verdict().wrong_error_model
    if right in ("student", "contaminated", "proportional"):
        said = " ".join(choice.results[0].verdict().wrong_error_model)
        cure = "proportional" if right == "proportional" else "student or contaminated"
        assert f"use the error model {cure}" in said, said


def test_errors_on_another_record_follow_its_response():
    """Twice the motion, twice the proportional error; the bands are not widened once more by the growth of the errors."""
    errors = si.Proportional(variance=(0.01 * SD) ** 2, share=0.1)
    posterior = si.Posterior(SPACE, MODEL, si.Observation(RECORD, proportional()), errors)
    result = si.sample(posterior, si.SMC(particles=200, steps=20), seed=1)
    prediction = result.predict(RECORD.scale_to_pga(0.9))
    large = np.abs(prediction.response[:, :, 0]).mean(axis=0) > 0.01
    ratio = (prediction.observable - prediction.response).std(axis=0)[large, 0] / np.abs(
        prediction.response[:, large, 0]
    ).mean(axis=0)
    assert np.median(ratio) == pytest.approx(0.1, rel=0.25)


def test_outliers_leave_no_doubt_of_the_mixture():
    """One per cent of errors of twenty standard deviations: Student's t leaves heavy tails, the mixture does not."""
    rng = np.random.default_rng(5)
    values = CLEAN + SD * normal() * np.where(rng.random(CLEAN.shape) < 0.01, 20.0, 1.0)
    found = {}
    for error_model in (si.Student(), si.Contaminated()):
        posterior = si.Posterior(SPACE, MODEL, si.Observation(RECORD, values), error_model)
        found[error_model.kind] = si.sample(posterior, si.SMC(particles=200, steps=20), seed=1)
    kurtosis = {kind: result.residuals[0].excess_kurtosis for kind, result in found.items()}
    assert abs(kurtosis["contaminated"]) < 0.5 < kurtosis["student"]
    assert found["contaminated"].log_evidence.value > found["student"].log_evidence.value + 5.0
    assert found["contaminated"].residuals[0].as_assumed
    assert 0.004 < found["contaminated"].flat[:, -2].mean() < 0.03


@pytest.mark.parametrize("wrong", [{"outlier_share": 1.0}, {"outlier_share": -0.1}, {"outlier_scale": 1.0}])
def test_wrong_outliers_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        si.Contaminated(**wrong)


def test_a_band_of_rounded_readings_holds_them():
    """Readings of another record lie on the grid inside the band; edges that are equal but for round-off do not exclude them."""
    step = 2.0 * np.abs(CLEAN).max() / 2**9
    posterior = si.Posterior(SPACE, MODEL, si.Observation(RECORD, rounded(9)), si.Quantised())
    result = si.sample(posterior, si.SMC(particles=200, steps=20), seed=1)
    other = si.GroundMotion.synthetic(seed=4).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(1.8)
    prediction = result.predict(other)
    readings = prediction.observable[:, :, 0] / step
    np.testing.assert_allclose(readings, np.round(readings), atol=1e-6)
    clean = MODEL.simulate(TRUTH, other).values[0, :, 0]
    measured = step * np.round(clean / step)
    low, high = (edge[:, 0] for edge in prediction.band(0.9, discrepancy=True))
    assert np.mean((low <= measured) & (measured <= high)) > 0.9
    # The band holds a few steps, not many, and one of the response alone is finer than a step.
    assert np.median(high - low) < 3.5 * step
    np.testing.assert_allclose(prediction.band()[0], np.quantile(prediction.response, 0.05, axis=0), rtol=1e-12)


def test_a_gap_is_no_value_off_the_grid():
    """Rounded values with an offset, of which some are missing."""
    values = rounded() + 0.3 * 2.0 * np.abs(CLEAN).max() / 2**7
    values[50:80] = np.nan
    posterior = si.Posterior(SPACE, MODEL, si.Observation(RECORD, values), si.Quantised())
    [step] = posterior.likelihood.of[0].discrepancy.describe()["resolution"].values()
    assert step == pytest.approx(2.0 * np.abs(CLEAN).max() / 2**7, rel=1e-9)
