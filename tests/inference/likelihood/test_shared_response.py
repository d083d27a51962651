"""Files of several sensors of one test: one run of the model answers for all of them, and the density is what it was."""

import jax
import numpy as np
import pytest

import structid as si
from structid.inference.likelihood.shared_response import of_one_run
from structid.models.hysteretic.bouc_wen import BoucWen

CHANNELS = ("displacement_1", "displacement_2", "absolute_acceleration_2")
RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 5.0).scale_to_pga(2.0)
OTHER = RECORD.scale(0.5)
SPACE = si.ParameterSpace(stiffness=si.Normal(7.4e6, 0.7e6, low=5e6, high=1e7), alpha=si.Uniform(0.02, 0.1))
FRAME = si.ShearFrame(
    storeys=2, mass=12e3, damping_ratio=0.03, beta=60.0, gamma_ratio=0.4, free=SPACE.names, channels=CHANNELS
)
CLEAN = FRAME.simulate(np.array([[7.2e6, 0.06]]), RECORD).values[0]
POINTS = SPACE.sample(4, seed=1).values


def noisy(column, seed, **settings):
    values = CLEAN[:, column]
    noise = 0.05 * values.std() * np.random.default_rng(seed).normal(size=values.shape)
    return si.Observation(RECORD, values + noise, CHANNELS[column], **settings)


def posterior(law, gain=None):
    settings = {} if gain is None else {"gain": gain}
    return si.Posterior(SPACE, FRAME, [noisy(0, 1), noisy(1, 2, **settings), noisy(2, 3)], law)


def alone(together, law):
    """The sum of the densities of each file by itself, at the same parameters."""

    def density(theta):
        prior = together.space.log_density(theta)
        total = prior.copy()
        for number, observation in enumerate(together.observations):
            single = si.Posterior(SPACE, FRAME, observation, law)
            columns = [together.names.index(n if n in together.names else f"{n}_{number + 1}") for n in single.names]
            total += single.log_likelihood(theta[:, columns])
        return total

    return density


LAWS = {"iid": si.IID(), "ar1": si.AR1(), "gain": si.IID()}


@pytest.mark.parametrize("name", LAWS)
def test_the_density_is_the_sum_of_those_of_each_file(name):
    law = LAWS[name]
    together = posterior(law, si.LogNormal(mean=1.0, sd=0.1) if name == "gain" else None)
    assert together.likelihood.of_one_run == ((0, 1, 2),) and together.in_lanes
    theta = together.space.sample(5, seed=2).values
    np.testing.assert_allclose(together.log_density(theta), alone(together, law)(theta), rtol=1e-11)


@pytest.mark.parametrize("name", LAWS)
def test_its_gradient_is_that_of_differences(name):
    together = posterior(LAWS[name], si.LogNormal(mean=1.0, sd=0.1) if name == "gain" else None)
    phi = together.initial(1, np.random.default_rng(1))
    density, data = together.traceable()
    slope = np.asarray(jax.grad(lambda point: density(point[None], data)[0])(phi[0]))
    steps = 1e-5 * np.eye(phi.shape[1])
    expected = [(together.evaluate(phi + s)[0] - together.evaluate(phi - s)[0])[0] / 2e-5 for s in steps]
    np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=1e-4 * np.abs(slope).max())


def test_the_misfit_is_that_of_all_channels_in_one_file():
    values = np.stack([noisy(k, k + 1).values[:, 0] for k in range(3)], axis=1)
    in_one = si.Posterior(SPACE, FRAME, si.Observation(RECORD, values, CHANNELS)).misfit
    apart = posterior(si.IID()).misfit
    np.testing.assert_allclose(apart(POINTS), in_one(POINTS), rtol=1e-12)
    for ours, theirs in zip(apart.linearised(POINTS), in_one.linearised(POINTS), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12 * np.abs(theirs).max())


def test_a_solver_of_ones_own_runs_once_a_point():
    calls = []

    def respond(parameters, record):
        calls.append(record.name)
        theta = np.array([[parameters["stiffness"], parameters["alpha"]]])
        return FRAME.simulate(theta, record).values[0]

    model = si.CallableModel(respond, free=SPACE.names, channels=CHANNELS, isolated=False)
    of = si.Posterior(SPACE, model, [noisy(k, k + 1) for k in range(3)])
    theta = of.space.sample(4, seed=1).values
    np.testing.assert_allclose(of.log_density(theta), posterior(si.IID()).log_density(theta), rtol=1e-9)
    assert len(calls) == 4


def test_another_record_is_another_run():
    second = si.Observation(OTHER, CLEAN[:, 0], CHANNELS[0])
    of = si.Posterior(SPACE, FRAME, [noisy(0, 1), second, noisy(1, 2)])
    assert of_one_run(of.likelihood.of) == ((0, 2), (1,))


def test_parameters_that_drift_in_one_test_do_so_for_all_of_its_sensors():
    oscillator = BoucWen(
        mass=12e3,
        damping_ratio=0.03,
        beta=60.0,
        gamma_ratio=0.4,
        free=SPACE.names,
        channels=("velocity", "displacement"),
    )
    y = oscillator.simulate(POINTS[:1], RECORD).values[0]
    first, other = (si.Observation(RECORD, y[:, k], channel) for k, channel in enumerate(oscillator.channels))
    again = si.Observation(RECORD, 0.9 * y[:, 0], "velocity")
    drifting = si.Posterior(SPACE, oscillator, [first, other], si.Drifting(1.0))
    assert drifting.likelihood.of_one_run == ((0, 1),)
    alone, second = (si.Posterior(SPACE, oscillator, each, si.Drifting(1.0)) for each in (first, other))
    assert set(drifting.names) - set(alone.names) == {f"{n}_1" for n in alone.hidden} | {"sigma2_1", "sigma2_2"}
    theta = alone.space.sample(3, seed=1).values
    plain = [name if name in alone.names else name.rpartition("_")[0] for name in drifting.names]
    both = theta[:, [alone.names.index(name) for name in plain]]
    expected = alone.log_likelihood(theta) + second.log_likelihood(theta)
    np.testing.assert_allclose(drifting.log_likelihood(both), expected, rtol=1e-11)
    repeated = si.Posterior(SPACE, oscillator, [first, again], si.Drifting(1.0))
    assert len(repeated.hidden) == 2 * len(alone.hidden)  # the same sensor once more is another test
    phi = drifting.initial(3, np.random.default_rng(1))
    points, _ = drifting.bijection(phi)
    np.testing.assert_allclose(drifting.bijection.inverse(points), phi, rtol=1e-9, atol=1e-9)
