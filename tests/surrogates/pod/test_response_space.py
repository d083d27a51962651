"""Response-space surrogates: the errors of their scores in a likelihood."""

import numpy as np
import pytest
import scipy.stats

import structid as si


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
