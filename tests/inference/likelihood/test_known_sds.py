"""Errors whose standard deviations are known value by value, and histories on a clock of their own."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.core.errors import InputError
from structid.study.run import load
from studies import SMALL

RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(2.0)
SPACE = si.ParameterSpace(stiffness=si.Normal(7.4e6, 0.7e6, unit="N/m"), alpha=si.Uniform(0.0, 0.2))
CHANNELS = ("velocity", "displacement")
MODEL = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma_ratio=0.2, free=SPACE.names, channels=CHANNELS)
THETA = np.array([[7.3e6, 0.05], [7.6e6, 0.11], [7.0e6, 0.02]])


def two_envelopes(values):
    """A standard deviation in the first half, and four times as much in the second, of each channel's RMS."""
    envelope = np.where(np.arange(len(values)) < len(values) // 2, 0.02, 0.08)[:, None]
    return envelope * np.sqrt((values**2).mean(axis=0))


def measured(channels=CHANNELS, seed=1):
    values = MODEL.simulate(THETA[:1], RECORD).values[0][:, [CHANNELS.index(c) for c in channels]]
    sd = two_envelopes(values)
    return values + sd * np.random.default_rng(seed).normal(size=values.shape), sd


def posterior(law, channels=CHANNELS, model=MODEL, **known):
    values, sd = measured(channels)
    return si.Posterior(SPACE, model, si.Observation(RECORD, values, channels, **{"sd": sd, **known}), law)


def likelihood(of, theta):
    return of.log_density(theta) - of.space.log_density(theta)


def residual(channels=CHANNELS):
    values, sd = measured(channels)
    response = MODEL.simulate(THETA, RECORD).values[:, :, [CHANNELS.index(c) for c in channels]]
    return values - response, sd


def test_known_errors_have_the_density_of_independent_normals():
    found = likelihood(posterior(si.IID(variance=1.0)), THETA)
    errors, sd = residual()
    np.testing.assert_allclose(found, scipy.stats.norm.logpdf(errors, scale=sd).sum(axis=(1, 2)), rtol=1e-10)


def test_an_unknown_factor_is_inferred_without_a_unit():
    of = posterior(si.IID(), CHANNELS[:1])
    assert of.names == ("stiffness", "alpha", "sigma2") and of.units["sigma2"] == ""
    theta = np.column_stack([THETA, [0.5, 1.0, 2.0]])
    errors, sd = residual(CHANNELS[:1])
    expected = scipy.stats.norm.logpdf(errors, scale=sd * np.sqrt(theta[:, 2])[:, None, None]).sum(axis=(1, 2))
    np.testing.assert_allclose(likelihood(of, theta), expected, rtol=1e-10)


def test_correlated_errors_over_an_envelope():
    """ε = D η, so that its covariance is D C D."""
    law = si.AR1(variance=1.0, white=0.0, correlation_time=0.05)
    of = posterior(law, CHANNELS[:1])
    errors, sd = residual(CHANNELS[:1])
    lags = np.abs(np.subtract.outer(np.arange(len(sd)), np.arange(len(sd))))
    covariance = sd * np.exp(-lags * RECORD.dt / 0.05) * sd.T
    expected = scipy.stats.multivariate_normal(np.zeros(len(sd)), covariance, allow_singular=True).logpdf(
        errors[..., 0]
    )
    np.testing.assert_allclose(likelihood(of, THETA), expected, rtol=1e-6)


@pytest.mark.parametrize("law", [si.IID(variance=1.0), si.AR1(variance=1.0, white=0.1, correlation_time=0.05)])
def scaled_record(parameters, record):
    """Of a user: velocity and displacement that are no physics."""
    return np.stack([1e-7 * parameters["stiffness"] * record.values, parameters["alpha"] * record.values], axis=1)


@pytest.mark.parametrize("law", [si.IID(variance=1.0), si.AR1(variance=1.0, white=0.1, correlation_time=0.05)])
@pytest.mark.parametrize("model", [MODEL, si.CallableModel(scaled_record, free=SPACE.names, channels=CHANNELS)])
def test_every_way_to_the_likelihood_is_the_same(law, model):
    """In lanes or on the host, of responses computed beforehand, and value by value."""
    of = posterior(law, model=model)
    expected = of.log_density(THETA)
    assert np.isfinite(expected).all()
    responses = [model.simulate(THETA, RECORD).values]
    np.testing.assert_allclose(of.given(responses).log_density(THETA), expected, rtol=1e-10)
    one_by_one = of.pointwise_log_likelihood(THETA, 0).sum(axis=(1, 2))
    np.testing.assert_allclose(one_by_one, likelihood(of, THETA), rtol=1e-10)
    squares = (((residual_of(of) / of.observations[0].sd) ** 2).sum(axis=1) * weights_of(of)).sum(axis=1)
    np.testing.assert_allclose(of.misfit(THETA), squares, rtol=1e-10)


def residual_of(posterior):
    return posterior.observations[0].values - posterior.predict(THETA, 0)


def weights_of(posterior):
    """The misfit of channels in several units divides each by its own sum of squares."""
    observation = posterior.observations[0]
    return 1.0 / ((observation.values / observation.sd) ** 2).sum(axis=0)


def test_one_number_is_a_variance():
    values, _ = measured(CHANNELS[:1])
    known = si.Posterior(SPACE, MODEL, si.Observation(RECORD, values, ("velocity",), sd=0.01), si.IID(variance=1.0))
    same = si.Posterior(SPACE, MODEL, si.Observation(RECORD, values, ("velocity",)), si.IID(variance=1e-4))
    np.testing.assert_allclose(known.log_density(THETA), same.log_density(THETA), rtol=1e-10)
    assert known.content_hash != same.content_hash


def test_the_precise_half_decides():
    """The posterior is that of the quiet half, and a little narrower; with one sd for all it is wider."""
    sampler = si.SMC(particles=200, steps=20, effective_share=0.5, correlation=0.4, scouts=0)
    known, plain = (
        si.sample(posterior(law, CHANNELS[:1], sd=sd), sampler, seed=1)
        for law, sd in ((si.IID(variance=1.0), measured(CHANNELS[:1])[1]), (si.IID(), None))
    )
    assert (known.sd[:2] < 0.75 * plain.sd[:2]).all()
    assert (np.abs(known.mean - THETA[0]) < 4.0 * known.sd).all()
    assert all(not residual.correlated for residual in known.residuals)
    band = known.predict(draws=200)
    wide = np.ptp(np.quantile(band.observable[:, :, 0], [0.05, 0.95], axis=0), axis=0)
    half = len(RECORD) // 2
    assert wide[half:].mean() / wide[:half].mean() == pytest.approx(4.0, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("law", [si.IID(variance=1.0), si.AR1(variance=1.0, white=0.1, correlation_time=0.05)])
def test_simulated_measurements_are_calibrated(law):
    assert si.sbc(posterior(law, CHANNELS[:1]), replicas=100, seed=1).uniform


@pytest.mark.parametrize(
    ("sd", "words"),
    [(-1.0, "positive and finite"), (np.ones(7), "an array of shape"), (np.nan, "nan, which is not a number")],
)
def test_wrong_sds_are_refused(sd, words):
    values, _ = measured()
    with pytest.raises(InputError, match=words):
        si.Observation(RECORD, values, CHANNELS, sd=sd)


# --- clocks -----------------------------------------------------------------------------------------------------


def written(path, start, dt=RECORD.dt, before=0, more=50, shift=0.0):
    """A history on a logger's clock: sines at the record's times, so that any shift shows."""
    time = dt * np.arange(-before, len(RECORD) + more)
    values = np.sin(2.0 * np.pi * 1.3 * (time - shift))
    sd = 0.1 + 0.0 * time
    np.savetxt(path, np.column_stack([start + time, values, sd]), fmt="%.9f")
    return np.sin(2.0 * np.pi * 1.3 * RECORD.dt * np.arange(len(RECORD)))


def test_a_clock_that_starts_elsewhere(tmp_path):
    expected = written(tmp_path / "a.txt", start=5.0)
    with pytest.raises(InputError, match="time_shift = 5"):
        si.Observation.read(RECORD, tmp_path / "a.txt", "m/s", column=1)
    found = si.Observation.read(RECORD, tmp_path / "a.txt", "m/s", time_shift=5.0, sd_column=2)
    np.testing.assert_allclose(found.values[:, 0], expected, atol=1e-8)
    np.testing.assert_allclose(found.sd, 0.1)


def test_a_logger_that_began_before_the_record_between_two_samples(tmp_path):
    written(tmp_path / "a.txt", start=0.37, before=37, shift=0.004)
    found = si.Observation.read(RECORD, tmp_path / "a.txt", "m/s", column=1, time_shift=0.374)
    assert found.start == pytest.approx(0.006) and found.left_out[0] == 38
    np.testing.assert_allclose(found.values[:, 0], np.sin(2.0 * np.pi * 1.3 * found.time), atol=1e-8)


def test_a_clock_that_is_known_roughly_has_a_prior(tmp_path):
    """The history is moved by the prior's median; what is left over is inferred, on the file's own clock."""
    expected = written(tmp_path / "a.txt", start=5.0)
    found = si.Observation.read(RECORD, tmp_path / "a.txt", "m/s", column=1, time_shift=si.Normal(5.0, 0.05))
    np.testing.assert_allclose(found.values[:, 0], expected, atol=1e-8)
    assert found.clock == 5.0 and found.describe()["clock"] == 5.0
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=0.05, beta=60.0, gamma_ratio=0.5, free=("stiffness",))
    posterior = si.Posterior(si.ParameterSpace(stiffness=si.Uniform(6e6, 8e6)), model, found, si.IID(1.0))
    at_home, late = posterior.predict(np.array([[7e6, 5.0], [7e6, 5.0 + 2.0 * RECORD.dt]]))[:, :, 0]
    plain = model.simulate(np.array([[7e6]]), RECORD).channel("velocity")[0]
    np.testing.assert_allclose(at_home, plain, atol=1e-13)
    np.testing.assert_allclose(late[2:], plain[:-2], atol=1e-13)
    written(tmp_path / "b.txt", start=0.0, more=0)
    together = si.Observation.read(RECORD, tmp_path / "b.txt", "m/s", column=1, time_shift=si.Normal(0.0, 0.05))
    assert together.clock == 0.0 and "clock" not in together.describe()
    written(tmp_path / "b.txt", start=0.0, more=50)  # what is left over at the end is cut
    longer = si.Observation.read(RECORD, tmp_path / "b.txt", "m/s", column=1, time_shift=si.Normal(0.0, 0.05))
    np.testing.assert_array_equal(longer.values, together.values)


def test_an_argument_that_is_none_of_a_file(tmp_path):
    written(tmp_path / "a.txt", start=0.0, more=0)
    with pytest.raises(InputError, match=r"'channels'.*Did you mean 'channel'"):
        si.Observation.read(RECORD, tmp_path / "a.txt", "m/s", column=1, channels=("velocity",))


def test_a_logger_that_began_after_the_record(tmp_path):
    expected = written(tmp_path / "a.txt", start=0.5)
    found = si.Observation.read(RECORD, tmp_path / "a.txt", "m/s", column=1, time_shift=0.2)
    assert found.time[0] == pytest.approx(0.3) and found.time[-1] <= RECORD.time[-1] + 1e-9
    np.testing.assert_allclose(found.values[:, 0], expected[: len(found.values)], atol=1e-8)
    with pytest.raises(InputError, match=r"times within the record.*sign"):
        si.Observation.read(RECORD, tmp_path / "a.txt", "m/s", column=1, time_shift=-20.0)


def test_a_number_is_no_prior_of_a_nuisance():
    values, _ = measured()
    with pytest.raises(InputError, match="a prior"):
        si.Observation(RECORD, values, CHANNELS, time_shift=0.2)


def test_a_study_says_it(tmp_path):
    written(tmp_path / "a.txt", start=5.0)
    begin, end = SMALL.index("[observation]"), SMALL.index("[discrepancy]") if "[discrepancy]" in SMALL else None
    rest = SMALL[end:] if end else SMALL[SMALL.index("[sampler]") :]
    table = '[observation]\nfile = "a.txt"\nunit = "m/s"\ncolumn = 1\ntime_shift = "5 s"\n'
    for known, sd in (('sd = "5 mm/s"', 0.005), ("sd_column = 2", 0.1)):
        (tmp_path / "study.toml").write_text(SMALL[:begin] + table + known + "\n" + rest)
        (observation,) = load(tmp_path / "study.toml").posterior.observations
        np.testing.assert_allclose(observation.sd, sd)
    (tmp_path / "study.toml").write_text(SMALL[:begin] + table + "sd = 1\nsd_column = 2\n" + rest)
    with pytest.raises(InputError, match="both sd and sd_column"):
        load(tmp_path / "study.toml")


def test_an_observation_of_another_sd_is_another_one():
    values, sd = measured()
    one, other = (si.Observation(RECORD, values, CHANNELS, sd=s) for s in (sd, 2.0 * sd))
    assert one.describe() != other.describe() != replace(other, sd=None).describe()
