"""Posteriors: prior, likelihood, Jacobian and nuisances as they are written in the definitions."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.core.errors import InputError
from structid.models.base import Model


def numpy_log_posterior(posterior, theta):
    """Written out again from the definitions."""
    total = posterior.space.log_density(theta)
    observation = posterior.observations[0]
    run = posterior.model.simulate(theta[:, : len(posterior.model.free)], observation.record)
    for i in range(len(theta)):
        sd = np.sqrt(theta[i, posterior.names.index("sigma2")])
        total[i] += scipy.stats.norm.logpdf(observation.values[:, 0], run.values[i, :, 0], sd).sum()
    return total


def test_log_density_is_prior_plus_gaussian_likelihood(short_posterior):
    theta = short_posterior.space.sample(7, seed=1).values
    np.testing.assert_allclose(
        short_posterior.log_density(theta), numpy_log_posterior(short_posterior, theta), rtol=1e-10
    )


def test_coordinates_carry_the_jacobian(short_posterior):
    theta = short_posterior.space.sample(5, seed=2).values
    phi = short_posterior.bijection.inverse(theta)
    density, failed = short_posterior.evaluate(phi)
    np.testing.assert_allclose(
        density, short_posterior.log_density(theta) + short_posterior.bijection(phi)[1], rtol=1e-9
    )
    assert not failed.any()


def test_pointwise_sums_to_the_log_likelihood(short_posterior):
    theta = short_posterior.space.sample(3, seed=2).values
    pointwise = short_posterior.pointwise_log_likelihood(theta)
    assert pointwise.shape == (3, 601, 1)
    np.testing.assert_allclose(pointwise.sum(axis=(1, 2)), short_posterior.log_likelihood(theta), rtol=1e-10)


def test_outside_the_prior_is_impossible_and_a_blow_up_is_counted(short_record):
    space = si.ParameterSpace(stiffness=si.Uniform(1e6, 1e13))
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma_ratio=1.0, free=("stiffness",))
    posterior = si.Posterior(space, model, si.Observation(short_record, np.ones(len(short_record))), si.IID(1.0))
    assert posterior.log_density(np.array([[1.0], [9e12], [7e6]]))[[0, 1]].tolist() == [-np.inf, -np.inf]
    density, failed = posterior.evaluate(posterior.bijection.inverse(np.array([[9e12], [7e6]])))
    assert failed.tolist() == [True, False]
    assert np.isfinite(density[1])


class HostOscillator(Model):
    """Somebody's solver: a NumPy model without derivatives."""

    def __init__(self, inner):
        self._inner, self.free, self.channels = inner, inner.free, inner.channels

    def run(self, theta, excitation, progress=None, map=None):
        return self._inner.run(theta, excitation, progress, map)

    @property
    def content_hash(self):
        return "host" + self._inner.content_hash


def test_any_model_has_the_same_posterior(short_posterior):
    host = si.Posterior(
        short_posterior.model_space, HostOscillator(short_posterior.model), short_posterior.observations
    )
    theta = short_posterior.space.sample(5, seed=1).values
    np.testing.assert_allclose(host.log_density(theta), short_posterior.log_density(theta), rtol=1e-10)
    np.testing.assert_allclose(host.misfit(theta[:, :4]), short_posterior.misfit(theta[:, :4]), rtol=1e-10)
    with pytest.raises(InputError, match="pattern search"):
        host.misfit.linearised(theta[:, :4])
    searched = si.optimize.pattern_search(host.misfit, starts=2, seed=1, iterations=5)
    assert np.isfinite(searched.best.value)


def test_nuisances_and_several_records(short_record, study_space):
    other = si.GroundMotion.synthetic(seed=9).lowpass(20.0).trim(4.0, 8.0).scale_to_pga(1.5)
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=study_space.names, substeps=1)
    truth = np.array([[7e6, 60.0, 0.3, 0.05]])
    values = [model.simulate(truth, r).channel("velocity")[0] for r in (short_record, other)]
    gain, offset, shift = 1.1, 0.004, 3.0 * short_record.dt
    shifted = np.concatenate([np.full(3, values[0][0]), values[0][:-3]])
    observations = [
        si.Observation(
            short_record,
            gain * shifted + offset,
            gain=si.Normal(1.0, 0.1),
            offset=si.Normal(0.0, 0.01),
            time_shift=si.Normal(0.0, 0.05),
        ),
        si.Observation(other, values[1]),
    ]
    posterior = si.Posterior(study_space, model, observations)
    assert posterior.names[4:] == ("gain_1", "offset_1", "time_shift_1", "sigma2_1", "sigma2_2")
    theta = np.concatenate([truth, [[gain, offset, shift, 1e-4, 1e-4]]], axis=1)
    np.testing.assert_allclose(posterior.predict(theta, 0)[0, :, 0], observations[0].values[:, 0], atol=1e-12)
    np.testing.assert_allclose(posterior.predict(theta, 1)[0, :, 0], values[1], atol=1e-12)
    expected = -0.5 * (601 + 401) * np.log(2 * np.pi * 1e-4)
    assert posterior.log_likelihood(theta)[0] == pytest.approx(expected, rel=1e-9)


def test_a_fraction_of_a_sample_of_shift_is_cubic(short_record, study_space):
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=study_space.names)
    truth = np.array([[7e6, 60.0, 0.3, 0.05]])
    observation = si.Observation(short_record, np.ones(601), time_shift=si.Uniform(-0.1, 0.1))
    posterior = si.Posterior(study_space, model, observation, si.IID(1.0))
    plain = posterior.predict(np.concatenate([truth, [[0.0]]], axis=1))[0, :, 0]
    half = posterior.predict(np.concatenate([truth, [[0.005]]], axis=1))[0, :, 0]
    fine = np.interp(short_record.time - 0.005, short_record.time, plain)  # linear: good to h² v″/8
    np.testing.assert_allclose(half[5:], fine[5:], atol=1e-2 * np.abs(plain).max())
    back = posterior.predict(np.concatenate([truth, [[0.01]]], axis=1))[0, :, 0]
    np.testing.assert_allclose(back[1:], plain[:-1], atol=1e-14)


def test_channels_have_their_own_variance(short_record, study_space):
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=study_space.names, channels=("displacement", "velocity"))
    run = model.simulate(np.array([[7e6, 60.0, 0.3, 0.05]]), short_record)
    posterior = si.Posterior(
        study_space, model, si.Observation(short_record, run.values[0], ("displacement", "velocity"))
    )
    assert posterior.names[4:] == ("sigma2_displacement", "sigma2_velocity")
    theta = np.array([[7e6, 60.0, 0.3, 0.05, 1e-6, 1e-3]])
    expected = -0.5 * 601 * (np.log(2 * np.pi * 1e-6) + np.log(2 * np.pi * 1e-3))
    assert posterior.log_likelihood(theta)[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda r: si.Observation(r, np.zeros(600)), "600 samples, but the record has 601"),
        (lambda r: si.Observation(r, np.zeros(601), dt=0.02), "time steps: 0.02 s and 0.01 s"),
        (lambda r: si.Observation(r, np.full(601, np.inf)), "601 infinite values"),
        (lambda r: si.Observation(r, np.zeros((601, 2))), "shape"),
        (lambda r: si.Observation(np.zeros(601), np.zeros(601)), "GroundMotion"),
    ],
)
def test_bad_observations_are_refused(short_record, make, words):
    with pytest.raises(InputError, match=words):
        make(short_record)


def test_names_must_match(short_record, study_space):
    observation = si.Observation(short_record, np.ones(601))
    with pytest.raises(InputError, match="stiffness"):
        model = si.BoucWen(mass=1.0, damping_ratio=0.03, free=("stiffness", "beta", "gamma_ratio", "alpha"))
        si.Posterior(si.ParameterSpace(stifness=si.Uniform(0, 1)), model, observation)
    with pytest.raises(InputError, match="not a free parameter"):
        model = si.BoucWen(mass=1.0, stiffness=1.0, alpha=0.1, beta=1.0, gamma=1.0, free=("exponent",))
        si.Posterior(si.ParameterSpace(exponent=si.Uniform(1, 2), extra=si.Uniform(0, 1)), model, observation)
    with pytest.raises(InputError, match="channels"):
        model = si.BoucWen(mass=1.0, damping_ratio=0.03, free=study_space.names)
        si.Posterior(study_space, model, si.Observation(short_record, np.ones(601), ("displacement",)))


def test_units_and_times_of_a_measured_file(short_record, tmp_path):
    path = tmp_path / "v.csv"
    np.savetxt(path, np.column_stack([short_record.time, np.sin(short_record.time)]), delimiter=",")
    assert si.Observation.read(short_record, path, "mm/s").values.max() < 1e-3 + 1e-12
    with pytest.raises(InputError, match="kN"):
        si.Observation.read(short_record, path, "kN")
    with pytest.raises(InputError, match="kN"):
        si.GroundMotion.read(path, unit="kN")
    np.savetxt(path, np.column_stack([3.0 + short_record.time, np.sin(short_record.time)]), delimiter=",")
    with pytest.raises(InputError, match="first time is 3"):
        si.Observation.read(short_record, path, "mm/s")
    path.write_text("nan\n1.0\n2.0\n3.0\n")
    with pytest.raises(InputError, match="line 1"):
        si.GroundMotion.read(path, dt=0.01, unit="g")
