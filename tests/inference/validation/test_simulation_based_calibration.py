"""Simulation-based calibration: right likelihoods pass, a wrong one fails, and so does a wrong surrogate."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.engine.lanes import machine
from structid.inference.validation.simulation_based_calibration import Ranks, ReplicatedPosterior

EXPLORER = si.SMC(particles=60, ensembles=1, steps=30, effective_share=0.5, correlation=0.3)
REPLICAS = 100


@pytest.fixture(scope="module")
def pieces():
    space = si.ParameterSpace(
        stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
    )
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=space.names, substeps=1)
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 7.0).scale_to_pga(2.0)
    clean = model.simulate(np.array([[7.2e6, 0.4]]), record).values[0, :, 0]
    return space, model, si.Observation(record, clean), float((0.2 * clean.std()) ** 2)


def posterior(pieces, law):
    space, model, observation, _ = pieces
    return si.Posterior(space, model, observation, law)


@pytest.mark.slow
def test_independent_noise_of_unknown_variance_is_calibrated(pieces):
    variance = pieces[-1]
    law = si.IID(variance=si.LogNormal(mean=variance, sd=0.3 * variance))
    found = si.sbc(posterior(pieces, law), REPLICAS, seed=1, sampler=EXPLORER)
    assert found.uniform and found.names == ("stiffness", "gamma_ratio", "sigma2", "log-likelihood")
    # Within 4 binomial standard deviations.
    for probability in (0.5, 0.9):
        sd = np.sqrt(probability * (1 - probability) / REPLICAS)
        assert (np.abs(found.coverage(probability) - probability) < 4 * sd).all(), str(found)
    assert "Calibrated" in str(found) and "90 % holds" in str(found)
    again = si.sbc(posterior(pieces, law), REPLICAS, seed=1, sampler=EXPLORER)
    np.testing.assert_array_equal(again.ranks, found.ranks)


@pytest.mark.slow
def test_correlated_noise_taken_for_independent_is_found_out(pieces):
    variance = pieces[-1]
    noise = si.AR1(variance=variance, white=0.0, correlation_time=0.1)
    found = si.sbc(posterior(pieces, si.IID(variance=variance)), REPLICAS, seed=2, sampler=EXPLORER, noise=noise)
    assert not found.uniform and found.coverage(0.9).min() < 0.75
    assert "NOT CALIBRATED" in str(found) and "too narrow" in found.verdict


def test_a_surrogate_is_put_to_the_test_with_the_model_behind_it(pieces):
    space, model, observation, variance = pieces
    law = si.IID(variance=variance / 400.0)
    true = posterior(pieces, law)
    few = si.PODKriging(limit=1.0, outside="allow").fit(
        si.Campaign(model, observation.record, space.sample(12, seed=1)).run()
    )
    blind = si.sbc(true.on(few), 60, seed=3, sampler=EXPLORER)
    seeing = si.sbc(true.on(few), 60, seed=3, sampler=EXPLORER, simulator=model)
    assert blind.uniform and not seeing.uniform, f"{blind}\n{seeing}"


LAWS = {"independent": lambda variance: si.IID(variance=variance), "correlated": lambda variance: si.AR1()}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", ["model", "surrogate", "surrogate with its own error", "external"])
def test_the_posteriors_side_by_side_are_those_of_each_replica(pieces, kind, law):
    space, model, observation, variance = pieces
    law = LAWS[law](variance)
    if kind == "external":
        stand_in = model

        def respond(parameters, record):
            return stand_in.simulate([[parameters[n] for n in stand_in.free]], record).values[0]

        model = si.CallableModel(respond, space.names, ("velocity",), isolated=False)
    elif kind.startswith("surrogate"):
        model = si.PODKriging(limit=1.0, outside="allow").fit(
            si.Campaign(model, observation.record, space.sample(20, seed=1)).run()
        )

    def alone(values):
        own = si.Observation(observation.record, values)
        return si.Posterior(space, model, own, law, model_error=kind.endswith("error"))

    noise = np.random.default_rng(1).normal(size=(3, *observation.values.shape)) * 0.01
    values, base = observation.values[None] + noise, alone(observation.values)
    target = ReplicatedPosterior(base, [values])
    phi = target.initial(12, np.random.default_rng(2))
    theta, jacobian = base.bijection(phi)
    prior, likelihood, failed = target.evaluate_parts(phi)
    each = [alone(v).log_likelihood(t) for v, t in zip(values, theta.reshape(3, 4, -1), strict=True)]
    np.testing.assert_allclose(likelihood, np.concatenate(each), rtol=1e-9)
    # The prior of an unknown variance depends on the measurement: that of the base holds for all.
    np.testing.assert_allclose(prior, base.space.log_density(theta) + jacobian, rtol=1e-9)
    np.testing.assert_allclose(target.evaluate(phi)[0], prior + likelihood, rtol=1e-12)
    np.testing.assert_allclose(target.log_density(theta) + jacobian, prior + likelihood, rtol=1e-9)
    assert not failed.any()
    assert kind != "model" or machine.why_not() or target._in_lanes is not None, "compiled lanes are not used"


def test_verdicts_of_made_up_ranks():
    rng = np.random.default_rng(4)
    truth, draws = np.zeros((200, 1)), rng.normal(size=(200, 50, 1))

    def ranks(shift, scale):
        centre = rng.normal(size=(200, 1))
        places = draws * scale + centre[:, None] + shift
        return Ranks(("a",), ("",), truth, places, (places < 0).sum(axis=1), 50)

    assert ranks(0.0, 1.0).uniform and "So few" not in ranks(0.0, 1.0).verdict
    whole = ranks(0.0, 1.0)
    few = Ranks(("a",), ("",), truth[:20], whole.draws[:20], whole.ranks[:20], 50)
    assert few.uniform and "So few replicas" in few.verdict and "±13%" in few.verdict
    assert "too narrow" in ranks(0.0, 0.3).verdict
    assert "too wide" in ranks(0.0, 4.0).verdict
    assert not ranks(1.0, 1.0).uniform
    # Half again as wide, which is little seen in the intervals of 50 %.
    assert "too wide" in ranks(0.0, 1.5).verdict
    assert "too large" in ranks(0.7, 1.0).verdict and "too small" in ranks(-0.7, 1.0).verdict
    np.testing.assert_array_equal(ranks(0.0, 1.0).histogram(10).sum(axis=1), [200])


def test_what_cannot_be_checked_is_refused(pieces):
    *_, variance = pieces
    with pytest.raises(InputError, match="20 or more"):
        si.sbc(posterior(pieces, si.IID(variance=variance)), 5)


def test_a_likelihood_that_does_not_see_the_data_is_found_out(pieces):
    """Its posterior is the prior, so that the ranks of every parameter are uniform."""
    variance = pieces[-1]
    blind = posterior(pieces, si.IID(variance=1e6 * variance))
    found = si.sbc(blind, 60, seed=4, sampler=EXPLORER, noise=si.IID(variance=variance))
    assert (found.p_values[:-1] > 0.01).all() and found.p_values[-1] < 1e-6
    assert not found.uniform and "log-likelihood of the truth" in found.verdict


@pytest.mark.parametrize("seed", range(3))
def test_intervals_that_hold_too_rarely_are_found_out(seed):
    """Posteriors a fifth too narrow: 90 % intervals hold 81 % of the truths, and the histogram of 200 ranks shows little of it."""
    rng = np.random.default_rng(seed)
    truth, draws = rng.normal(size=(400, 1)), 0.78 * rng.normal(size=(400, 300, 1))
    ranks = (draws < truth[:, None]).sum(axis=1)
    found = Ranks(("x",), ("",), truth, draws, ranks, 300)
    assert not found.uniform, str(found)
    right = Ranks(("x",), ("",), truth, draws / 0.78, ((draws / 0.78) < truth[:, None]).sum(axis=1), 300)
    assert right.uniform, str(right)
