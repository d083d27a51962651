"""Response-space surrogates: the errors of their scores in a likelihood."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.core.errors import InputError, StructidWarning


@pytest.fixture(scope="module")
def unsure(short_posterior):
    """A POD-Kriging of few runs, and points of the posterior on it."""
    record = short_posterior.observations[0].record
    design = short_posterior.model_space.sample(30, seed=2)
    surrogate = si.PODKriging(limit=1.0, outside="allow").fit(si.Campaign(short_posterior.model, record, design).run())
    theta = short_posterior.bijection(short_posterior.initial(3, np.random.default_rng(1)))[0]
    return surrogate, theta


def test_the_scores_errors_are_integrated_out_exactly(unsure, short_posterior):
    """Against the dense covariance σ²I + Φᵀ S Φ."""
    surrogate, theta = unsure
    observation = short_posterior.observations[0]
    posterior = si.Posterior(short_posterior.model_space, surrogate, observation, model_error=True)
    fit = surrogate.records[observation.record.content_hash]
    scores = surrogate.held_inside(theta[:, :4])
    deviation = fit.scores.predict(scores, return_std=True)[1]
    modes, left_out = fit.modes * fit.scale[0], np.mean(fit.truncation**2) * fit.scale[0] ** 2
    mean = surrogate.simulate(theta[:, :4], observation.record).values[:, :, 0]
    for row, found in enumerate(posterior.log_likelihood(theta)):
        covariance = (theta[row, 4] + left_out) * np.eye(len(mean[row])) + (modes.T * deviation[row] ** 2) @ modes
        expected = scipy.stats.multivariate_normal(mean[row], covariance).logpdf(observation.values[:, 0])
        assert found == pytest.approx(expected, rel=1e-10)
    plain = si.Posterior(short_posterior.model_space, surrogate, observation)
    assert plain.content_hash != posterior.content_hash
    assert (np.abs(posterior.log_likelihood(theta) - plain.log_likelihood(theta)) > 1.0).any()


def test_elsewhere_the_mean_variance_counts_as_white_noise(unsure, short_posterior):
    surrogate, theta = unsure
    observation = short_posterior.observations[0]
    law = si.AR1(variance=1e-4, white=1e-5, correlation_time=0.05)
    found = si.Posterior(short_posterior.model_space, surrogate, observation, law, model_error=True)
    values = surrogate.simulate(theta[:, :4], observation.record).values
    variance = (surrogate.standard_deviation(theta[:, :4], observation.record, values) ** 2).mean(axis=1)[:, 0]
    for row, more in enumerate(variance):
        wider = si.AR1(variance=1e-4, white=1e-5 + float(more), correlation_time=0.05)
        expected = si.Posterior(short_posterior.model_space, surrogate, observation, wider)
        one = theta[row : row + 1, :4]
        np.testing.assert_allclose(found.log_likelihood(one), expected.log_likelihood(one), rtol=1e-9)


def test_a_model_that_stands_for_itself_has_no_error_to_add(short_posterior):
    theta = short_posterior.bijection(short_posterior.initial(3, np.random.default_rng(1)))[0]
    p = short_posterior
    with_it = si.Posterior(p.model_space, p.model, p.observations, p.discrepancy, model_error=True)
    np.testing.assert_allclose(with_it.log_likelihood(theta), p.log_likelihood(theta), rtol=1e-12)


def test_many_components_of_several_channels_are_compiled(short_posterior):
    """Rows of the modes are long then: 3 channels × 99 components. Against the law given the responses themselves."""
    record, space = short_posterior.observations[0].record, short_posterior.model_space
    model = short_posterior.model.recording("displacement", "velocity", "restoring_force")
    design = space.sample(100, seed=2)
    surrogate = si.PODKriging(limit=1.0, left_out_energy=0.0, outside="allow").fit(
        si.Campaign(model, record, design).run()
    )
    fit = surrogate.records[record.content_hash]
    assert len(fit.modes) * len(fit.scale) > 256
    values = model.simulate(space.sample(1, seed=3).values, record).values[0]
    law = si.AR1(variance=1e-4, white=1e-5, correlation_time=0.05)
    posterior = si.Posterior(space, surrogate, si.Observation(record, values, model.channels), law)
    assert posterior.in_lanes
    theta = space.sample(20, seed=4).values
    given = posterior.given([surrogate.simulate(theta, record).values])
    np.testing.assert_allclose(posterior.log_density(theta), given.log_density(theta), rtol=1e-9)


SPRING = si.ParameterSpace(stiffness=si.Uniform(5.0, 10.0, unit="kN/mm"))


@pytest.fixture(scope="module")
def within():
    """Runs of a spring between 6 and 8 kN/mm."""
    record = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 6.0).scale_to_pga(1.0)
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=0.5, beta=60.0, gamma_ratio=0.5, free=SPRING.names)
    return model, si.Campaign(model, record, si.Design(np.linspace(6e6, 8e6, 12)[:, None], SPRING)).run()


def test_how_far_it_reaches(within, tmp_path):
    """It extrapolates with its own variance, as far as it was told to, and stays as it is there from then on."""
    model, runs = within
    record = runs.records[0]
    held, reaching = (si.PODKriging(reach=reach).fit(runs) for reach in (None, 0.2))
    low, high = reaching.fitted.ends
    margin = 0.2 * (reaching.fitted.high - reaching.fitted.low)
    np.testing.assert_allclose([low, high], [reaching.fitted.low - margin, reaching.fitted.high + margin])
    np.testing.assert_array_equal(held.fitted.ends, [held.fitted.low, held.fitted.high])
    just_outside = np.array([[8.3e6]])
    with pytest.warns(StructidWarning, match="the response is computed at the nearest point of the range"):
        at_the_edge = held.simulate(just_outside, record).values
    with pytest.warns(StructidWarning, match=r"by extrapolation up to 0.2 times the range's width"):
        extrapolated, spread = reaching.predict(just_outside, record, return_std=True)
    true = model.simulate(just_outside, record).values
    assert np.abs(extrapolated.values - true).max() < 0.3 * np.abs(at_the_edge - true).max()
    assert spread.max() > 3.0 * reaching.predict(np.array([[7e6]]), record, return_std=True)[1].max()
    with pytest.warns(StructidWarning):
        far = [reaching.simulate(np.array([[k]]), record).values for k in (high[0], 9.9e6)]
    np.testing.assert_array_equal(*far)
    again = si.load_surrogate(reaching.save(tmp_path / "surrogate.h5"))
    assert again.fitted.reach == 0.2 and again.content_hash == reaching.content_hash != held.content_hash


def test_it_reaches_no_further_than_the_prior(within):
    _, runs = within
    np.testing.assert_array_equal(si.PODKriging(reach=5.0).fit(runs).fitted.ends, SPRING.bounds.T)
    with pytest.raises(InputError, match=r"reach: -1.*0 or more"):
        si.PODKriging(reach=-1.0)


def test_what_stands_for_it_in_a_calibration():
    """It reaches further and keeps more components, unless it was told otherwise."""
    usual = si.PODKriging().forms
    assert len(usual) == 4 and {(f.reach, f.left_out_energy) for f in usual} == {(0.5, 1e-13)}
    told = si.PODKriging(si.Kriging(trend="quadratic"), left_out_energy=1e-6, reach=0.0).forms
    assert told == (si.PODKriging(si.Kriging(trend="quadratic"), left_out_energy=1e-6, reach=0.0),)
