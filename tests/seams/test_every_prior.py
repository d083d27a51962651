"""Every family of priors goes through all that a prior goes through, on both engines: densities, samplers, files, a study."""

import dataclasses
import pickle

import jax
import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.calibration.calibration_result import CalibrationResult
from structid.study.run import run_study

PRIORS = {
    "Uniform": si.Uniform(0.03, 0.09),
    "Normal": si.Normal(0.06, 0.01),
    "LogNormal": si.LogNormal(mean=0.06, sd=0.01, high=1.0),
    "Gamma": si.Gamma(mean=0.06, sd=0.01, high=1.0),
    "Beta": si.Beta(mean=0.06, sd=0.01),
    "Weibull": si.Weibull(mean=0.06, sd=0.01, high=1.0),
    "Gumbel": si.Gumbel(mean=0.06, sd=0.01, low=0.0),
    "Frozen": si.Frozen(scipy.stats.triang(0.5, loc=0.03, scale=0.06)),
}
RECORD = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 7.0).scale_to_pga(1.8)
MODEL = si.BoucWen(mass=12e3, damping_ratio=0.03, stiffness=7.5e6, beta=60.0, gamma=30.0, free=("alpha",), substeps=1)
MEASURED = MODEL.simulate([[0.055]], RECORD).values[0]
NOISE = 0.05 * MEASURED.std() * np.random.default_rng(1).standard_normal(MEASURED.shape)


@pytest.fixture(params=["lanes", "jax"])
def engine(request, monkeypatch):
    monkeypatch.setenv("STRUCTID_ENGINE", "" if request.param == "lanes" else "jax")
    return request.param


def thinned(families):
    """The family that is hardest on both engines; the others, which take a minute together, on the engine that users have."""
    both = [pytest.param(engine, "Beta") for engine in ("lanes", "jax")]
    return both + [pytest.param("lanes", family, marks=pytest.mark.slow) for family in families if family != "Beta"]


def posterior(family, engine):
    """A model of its own, so that nothing is compiled yet: a prior that is met inside a trace first is the hard case."""
    space = si.ParameterSpace(alpha=PRIORS[family])
    model = MODEL.recording("velocity") if engine == "lanes" else dataclasses.replace(MODEL, substeps=2)
    return si.Posterior(space, model, si.Observation(RECORD, MEASURED + NOISE), si.IID(variance=float(NOISE.var())))


def fresh(family):
    """The same prior as it is before anybody has asked it anything."""
    return si.ParameterSpace.from_plain(si.ParameterSpace(alpha=PRIORS[family]).to_plain()).marginals["alpha"]


@pytest.mark.parametrize("family", PRIORS)
def test_densities_twice_then_draws(family, engine, monkeypatch):
    monkeypatch.setitem(PRIORS, family, fresh(family))
    of = posterior(family, engine)
    theta = np.linspace(0.045, 0.07, 5)[:, None]
    first = of.log_density(theta)
    np.testing.assert_array_equal(of.log_density(theta), first)
    expected = PRIORS[family].log_density(theta[:, 0]) + of.log_likelihood(theta)
    np.testing.assert_allclose(first, expected, rtol=1e-9)
    result = si.sample(of, si.SMC(particles=40, ensembles=2, steps=4, effective_share=0.5), seed=1)
    assert abs(result.summary().columns["mean"][0] - 0.055) < 0.01
    np.testing.assert_array_equal(of.log_density(theta), first)


def test_derivatives_of_a_posterior(engine, monkeypatch):
    monkeypatch.setitem(PRIORS, "Beta", fresh("Beta"))
    result = si.sample(posterior("Beta", engine), si.NUTS(chains=2, steps=30, warm_up=50), seed=1)
    assert abs(result.summary().columns["mean"][0] - 0.055) < 0.01


@pytest.mark.slow
def test_derivatives_of_every_family():
    """All in one density, so that each is met inside a trace first: gradients, and draws by them."""
    space = si.ParameterSpace(**{family: fresh(family) for family in PRIORS})
    box = {name: tuple(map(float, support)) for name, support in zip(space.names, space.bounds, strict=True)}
    of = si.LogDensity(space.jax_log_density, space.names, space, box, backend="jax")
    slopes = jax.grad(space.jax_log_density)(jax.numpy.full(len(PRIORS), 0.055))
    for name, slope in zip(space.names, slopes, strict=True):
        sides = PRIORS[name].log_density(np.array([0.055 - 1e-6, 0.055 + 1e-6]))
        assert slope == pytest.approx((sides[1] - sides[0]) / 2e-6, rel=1e-5, abs=1e-6), name
    found = si.sample(of, si.NUTS(chains=2, steps=50, warm_up=80), seed=1)
    prior = space.sample(2000, seed=1).values
    off = (found.mean - prior.mean(axis=0)) / prior.std(axis=0)
    assert (np.abs(off) < 0.6).all(), off


@pytest.mark.parametrize("family", PRIORS)
def test_it_can_be_sent_and_stored_at_any_time(family, engine, tmp_path, monkeypatch):
    """Before it was used, and after it was used inside JAX."""
    monkeypatch.setitem(PRIORS, family, fresh(family))
    of = posterior(family, engine)
    theta = np.array([[0.05], [0.06]])
    sent = pickle.loads(pickle.dumps(of)).log_density(theta)
    np.testing.assert_allclose(of.log_density(theta), sent, rtol=1e-12)
    np.testing.assert_allclose(pickle.loads(pickle.dumps(of)).log_density(theta), sent, rtol=1e-12)
    result = si.sample(of, si.SMC(particles=40, ensembles=2, steps=4, effective_share=0.5), seed=1)
    assert result.to_netcdf(tmp_path / "draws.nc").is_file()
    again = si.ParameterSpace.from_plain(of.space.to_plain())
    np.testing.assert_array_equal(again.log_density(theta), of.space.log_density(theta))


STUDY = """
name = "prior"
record = { synthetic = { seed = 8, duration = "6 s", middle = "2 s", significant_duration = "3 s" }, pga = "1.8 m/s^2" }
model = { type = "bouc_wen", mass = "12 t", damping_ratio = 0.03, stiffness = "7.5 kN/mm", beta = 60, gamma = 30, substeps = 1 }
observation = { channels = ["velocity"], virtual = { noise = 0.05, model = { type = "bouc_wen", mass = "12 t", \
damping_ratio = 0.03, stiffness = "7.5 kN/mm", beta = 60, gamma = 30, alpha = 0.055, substeps = 1 } } }
surrogate = { kind = "pod_kriging" }
calibration = { true_runs = 80 }
sampler = { kind = "smc", particles = 100, steps = 10 }
discrepancy = { kind = "iid" }
parameters = { alpha = %s }
"""
IN_A_STUDY = {
    "Uniform": '{ distribution = "uniform", low = 0.03, high = 0.09 }',
    **{
        name.capitalize(): f'{{ distribution = "{name}", mean = 0.06, sd = 0.01, low = 0.0, high = 1.0 }}'
        for name in ("normal", "gamma", "weibull", "gumbel")
    },
    "LogNormal": '{ distribution = "lognormal", mean = 0.06, sd = 0.01, high = 1.0 }',
    "Beta": '{ distribution = "beta", mean = 0.06, sd = 0.01 }',
}


@pytest.mark.slow
@pytest.mark.parametrize(("engine", "family"), thinned(IN_A_STUDY), indirect=["engine"])
def test_a_calibration_and_its_page(family, engine, tmp_path):
    """In a study: sequential design, surrogate, certificate, netCDF, page."""
    (tmp_path / "study.toml").write_text(STUDY % IN_A_STUDY[family])
    outcome = run_study(tmp_path / "study.toml", tmp_path / "out")
    assert CalibrationResult in outcome.results and outcome.report.is_file()
    assert abs(outcome.result.summary().columns["mean"][0] - 0.055) < 0.01
    assert PRIORS.keys() == {*IN_A_STUDY, "Frozen"}
