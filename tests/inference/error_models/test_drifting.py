"""Errors inside the model: whose parameters they are, what they predict of another record, what is refused."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.core.errors import InputError

SPACE = si.ParameterSpace(
    stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"), gamma_ratio=si.Uniform(-1.0, 1.0)
)
MODEL = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, alpha=0.06, free=SPACE.names, substeps=1)
RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 7.0).scale_to_pga(2.0)
OTHER = si.GroundMotion.synthetic(seed=4).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(2.0)
CLEAN = MODEL.simulate(np.array([[7.2e6, 0.4]]), RECORD).values[0, :, 0]


def posterior(law, observations=1):
    measured = [si.Observation(RECORD, CLEAN * (1.0 + 1e-3 * i), name=str(i)) for i in range(observations)]
    return si.Posterior(SPACE, MODEL, measured, law)


def test_parameters_are_those_of_the_model_their_drifts_and_what_they_are_at_the_knots():
    of = posterior(si.Drifting(every=2.0))
    assert of.names[:5] == ("stiffness", "gamma_ratio", "stiffness_drift", "gamma_ratio_drift", "sigma2")
    assert of.names[5:] == tuple(f"{name}_at_{knot}" for name in SPACE.names for knot in (1, 2, 3))
    assert of.hidden == set(of.names[5:]) and of.shown == [0, 1, 2, 3, 4]
    assert of.units["stiffness_drift"] == "kN/mm" and of.error_model.describe()["every"] == 2.0
    low, high = of.space.marginals["stiffness_drift"].quantile(np.array([0.025, 0.975]))
    sd = SPACE.marginals["stiffness"].moments[1]
    np.testing.assert_allclose([low, high], [0.01 * sd, sd], rtol=1e-3)
    assert len(posterior(si.Drifting()).hidden) == 2 * 6, "five spans of the record"


def test_its_density_is_that_of_the_model_with_these_parameters():
    """log π(θ, d, b) + Σ log N(y | M(θ + d∘b), σ²), and the same in the coordinates of a sampler."""
    of = posterior(si.Drifting(every=2.0))
    phi = of.initial(6, np.random.default_rng(1))
    theta, jacobian = of.bijection(phi)
    drifting = of.likelihood.of[0].model
    response = drifting.simulate(theta[:, [0, 1, 2, 3, *range(5, 11)]], RECORD).values[:, :, 0]
    errors = scipy.stats.norm.logpdf(CLEAN - response, scale=np.sqrt(theta[:, 4:5])).sum(axis=1)
    np.testing.assert_allclose(of.log_density(theta), of.space.log_density(theta) + errors, rtol=1e-9)
    np.testing.assert_allclose(of.evaluate(phi)[0], of.log_density(theta) + jacobian, rtol=1e-9)
    np.testing.assert_allclose(of.predict(theta)[:, :, 0], response, rtol=1e-9, atol=1e-12)
    # A sampler moves the parameter that there is at a knot, not its standardised distance.
    at_knot = theta[:, 0] + theta[:, 2] * theta[:, 5]
    assert np.ptp((at_knot - SPACE.marginals["stiffness"].moments[0]) / phi[:, 5]) < 1e-6 * np.abs(at_knot).max()


def test_several_records_share_the_drift_and_have_their_own_course():
    of = posterior(si.Drifting(every=4.0), observations=2)
    assert [n for n in of.names if "stiffness" in n] == ["stiffness", "stiffness_drift"] + [
        f"stiffness_at_{knot}_{record}" for record in (1, 2) for knot in (1, 2)
    ]
    theta = of.space.sample(2, seed=1).values
    single = posterior(si.Drifting(every=4.0))
    alone = theta[:, [of.names.index(name if name in of.names else f"{name}_2") for name in single.names]]
    np.testing.assert_array_equal(of.predict(theta, 1), single.predict(alone))


def test_on_another_record_parameters_drift_in_another_way_and_as_far():
    of = posterior(si.Drifting(every=2.0))
    theta = np.tile(of.space.sample(1, seed=1).values, (4000, 1))
    model, parameters = of.likelihood.on_record(theta, OTHER, np.random.default_rng(1), None)
    assert model.knots == 4 and model.every == 2.0
    assert (parameters[:, :4] == theta[0, :4]).all()
    # Moments of N(0, 1) within five of their own standard errors.
    at = parameters[:, 4:]
    assert at.shape == (4000, 8)
    assert (np.abs(at.mean(axis=0)) < 5 / np.sqrt(4000)).all()
    assert (np.abs(at.var(axis=0) - 1.0) < 5 * np.sqrt(2 / 4000)).all()
    np.testing.assert_array_equal(
        of.likelihood.on_record(theta[:3], RECORD, None, 0)[1], of.likelihood.of[0].parameters(theta[:3])
    )


def test_errors_that_are_added_may_have_any_law():
    beside = posterior(si.Drifting(every=2.0, errors=si.AR1()))
    assert {"sigma2", "sigma2_white", "correlation_time"} < set(beside.names)
    assert beside.discrepancy.describe()["kind"] == "ar1" and beside.error_model.describe()["errors"]["kind"] == "ar1"
    assert np.isfinite(beside.log_density(beside.space.sample(3, seed=1).values)).all()


def test_what_cannot_drift_is_refused():
    with pytest.raises(InputError, match="time between knots"):
        si.Drifting(every=-1.0)
    with pytest.raises(InputError, match=r"Drifting\(every\): a prior\. Expected: a number"):
        si.Drifting(every=si.Uniform(1.0, 2.0))
    with pytest.raises(InputError, match=r"puts 4000 knots in a record of 4 s.*0.04 s or more"):
        posterior(si.Drifting(every=0.001))
    with pytest.raises(InputError, match=r"varies the model's parameters in time.*Sample the model itself"):
        si.calibrate(MODEL, SPACE, si.Observation(RECORD, CLEAN), discrepancy=si.Drifting())


def scattered(law, replicas):
    """Means and sds of the stiffness of structures that degrade, found by a model that does not, over records."""
    truth = si.BoucWen(
        mass=12_000.0,
        damping_ratio=0.03,
        stiffness=7.2e6,
        gamma_ratio=0.4,
        beta=60.0,
        alpha=0.06,
        delta_nu=1.0,
        delta_eta=3.0,
        substeps=1,
    )
    found = []
    for seed in range(replicas):
        record = si.GroundMotion.synthetic(seed=seed).lowpass(20.0).trim(3.0, 13.0).scale_to_pga(1.8)
        clean = truth.simulate(np.zeros((1, 0)), record).values[0, :, 0]
        noisy = clean + 0.02 * clean.std() * np.random.default_rng(seed).normal(size=clean.shape)
        sampler = si.SMC(particles=200, steps=25, ensembles=2, effective_share=0.5, correlation=0.4)
        result = si.sample(si.Posterior(SPACE, MODEL, si.Observation(record, noisy), law), sampler, seed=seed)
        found.append((result.mean[0], result.sd[0]))
    means, sds = np.array(found).T
    return means.std(ddof=1) / np.sqrt(np.mean(sds**2))


@pytest.mark.slow
def test_a_wrong_model_is_as_unsure_as_it_scatters():
    """Over eight records the scatter of the means is known to a quarter: 1.5 is allowed, independent errors fail."""
    assert scattered(si.IID(), 8) > 4.0
    assert scattered(si.Drifting(), 8) < 1.5


@pytest.mark.slow
def test_ranks_of_parameters_that_do_drift_are_uniform():
    space = si.ParameterSpace(stiffness=si.Normal(7.4, 0.7, low=5.0, high=10.0, unit="kN/mm"))
    model = si.BoucWen(
        mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma=20.0, alpha=0.06, free=("stiffness",), substeps=1
    )
    law = si.Drifting(every=2.0, errors=si.IID(variance=float(0.1 * CLEAN.std()) ** 2))
    explorer = si.SMC(particles=80, ensembles=1, steps=40, effective_share=0.5, correlation=0.3)
    ranks = si.sbc(si.Posterior(space, model, si.Observation(RECORD, CLEAN), law), 100, seed=1, sampler=explorer)
    assert ranks.uniform, str(ranks)
