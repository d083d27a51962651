"""Sensors with gaps, with their own rate and start, and with an unknown direction."""

import numpy as np
import pytest
import scipy.interpolate
import scipy.stats

import structid as si
from structid.core.errors import InputError
from structid.sensor_sampling import SensorSampling

RECORD = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(2.0)
SPACE = si.ParameterSpace(stiffness=si.Normal(7.4e6, 0.7e6, unit="N/m"), alpha=si.Uniform(0.0, 0.2))
CHANNELS = ("velocity", "displacement")
MODEL = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma_ratio=0.2, free=SPACE.names, channels=CHANNELS)
THETA = np.array([[7.3e6, 0.05], [7.6e6, 0.11], [7.0e6, 0.02]])
RESPONSE = MODEL.simulate(THETA, RECORD).values
NOISE = 0.003

VARIANCE, WHITE, TIME = 1e-5, 2e-6, 0.08
KERNELS = {
    "iid": (si.IID(variance=VARIANCE), lambda lag: VARIANCE * (lag == 0.0)),
    "ar1": (si.AR1(VARIANCE, WHITE, TIME), lambda lag: VARIANCE * np.exp(-lag / TIME) + WHITE * (lag == 0.0)),
    "matern32": (
        si.Matern32(VARIANCE, WHITE, TIME),
        lambda lag: (
            VARIANCE * (1.0 + np.sqrt(3.0) * lag / TIME) * np.exp(-np.sqrt(3.0) * lag / TIME) + WHITE * (lag == 0.0)
        ),
    ),
    "damped cosine": (si.DampedCosine(VARIANCE, WHITE, 3.0, 0.2), lambda lag: cosine(lag) + WHITE * (lag == 0.0)),
}
FLOOR = 1e-10
"""Share of the correlated variance that the error models add to the white variance."""


def cosine(lag, frequency=3.0, damping=0.2):
    eta, omega = damping * 2.0 * np.pi * frequency, 2.0 * np.pi * frequency * np.sqrt(1.0 - damping**2)
    return VARIANCE * np.exp(-eta * lag) * (np.cos(omega * lag) + eta / omega * np.sin(omega * lag))


def at_times(times, column=0, run=0):
    """Response at any times, by an interpolation other than the program's."""
    spline = scipy.interpolate.make_interp_spline(RECORD.time, RESPONSE[run, :, column], k=7)
    return spline(times)


def with_gaps(values, share=0.2, seed=2):
    values = values.copy()
    values[np.random.default_rng(seed).random(len(values)) < share] = np.nan
    return values


def sensor(dt, start, column=0, seed=1, share=0.2, **settings):
    """A sensor with its own rate and start, and gaps."""
    times = np.arange(start, RECORD.time[-1], dt)
    values = at_times(times, column) + NOISE * np.random.default_rng(seed).normal(size=len(times))
    return si.Observation(RECORD, with_gaps(values, share), (CHANNELS[column],), dt=dt, start=start, **settings)


SENSORS = {
    "times of the record": lambda: si.Observation(RECORD, with_gaps(RESPONSE[0, :, 0]), ("velocity",)),
    "every second sample": lambda: sensor(2 * RECORD.dt, 5 * RECORD.dt),
    "slower": lambda: sensor(1.0 / 64.0, 0.123),
    "faster": lambda: sensor(1.0 / 256.0, 0.0007),
    "gaps and known sds": lambda: sensor(1.0 / 64.0, 0.123, sd=0.5 + np.arange(377) / 377.0),
}


def likelihood(of, theta=THETA):
    return of.log_density(theta) - of.space.log_density(theta)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("kind", SENSORS)
def test_likelihood_is_that_of_the_dense_covariance(kind, kernel):
    """The covariance of the measured values alone, with no trace of the missing ones."""
    error_model, covariance = KERNELS[kernel]
    observation = SENSORS[kind]()
    of = si.Posterior(SPACE, MODEL, observation, error_model)
    known = observation.is_measured[:, 0]
    times = observation.time[known]
    sd = np.ones(known.sum()) if observation.sd is None else observation.sd[known, 0]
    dense = covariance(np.abs(np.subtract.outer(times, times)).round(12))
    dense = sd[:, None] * (dense + (kernel != "iid") * FLOOR * VARIANCE * np.eye(len(sd))) * sd
    predicted = of.predict(THETA)[:, known, 0]
    expected = scipy.stats.multivariate_normal(np.zeros(len(sd)), dense, allow_singular=False).logpdf(
        observation.values[known, 0] - predicted
    )
    np.testing.assert_allclose(likelihood(of), expected, rtol=1e-9)
    np.testing.assert_allclose(of.pointwise_log_likelihood(THETA).sum(axis=(1, 2)), expected, rtol=1e-9)
    np.testing.assert_allclose(of.given([RESPONSE]).log_density(THETA), of.log_density(THETA), rtol=1e-12)
    blocks = (response[None] for response in RESPONSE)
    np.testing.assert_allclose(of.given([blocks]).log_density(THETA), of.log_density(THETA), rtol=1e-12)


@pytest.mark.parametrize("kind", ["slower", "faster"])
def test_vector_code_and_jax_agree(kind, monkeypatch):
    observations = [SENSORS[kind](), sensor(0.0131, 0.5, column=1)]
    in_lanes = si.Posterior(SPACE, MODEL, observations, KERNELS["ar1"][0])
    expected = in_lanes.log_density(THETA)
    assert in_lanes.in_lanes
    monkeypatch.setattr("structid.engine.lanes.in_lanes.InLanes.compiled", lambda *_: None)
    by_jax = si.Posterior(SPACE, MODEL, observations, KERNELS["ar1"][0])
    np.testing.assert_allclose(by_jax.log_density(THETA), expected, rtol=1e-11)


def test_predictions_at_the_times_of_the_sensor():
    of = si.Posterior(SPACE, MODEL, sensor(1.0 / 64.0, 0.123), si.IID())
    theta = np.column_stack([THETA, np.ones(3)])
    times = of.observations[0].time
    for run, predicted in enumerate(of.predict(theta)[:, :, 0]):
        expected = at_times(times, run=run)
        # The response has kinks in its higher derivatives, at the samples of the record.
        np.testing.assert_allclose(predicted, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize(("per_period", "limit"), [(20.0, 5e-6), (10.0, 4e-4), (6.3, 5e-3)])
def test_error_between_samples(per_period, limit):
    """The limits that `sensor_sampling` states, in the interior of a record; a polynomial of degree 5 is exact there."""
    steps, times = 500, np.arange(0.37, 498.0, 1.28)
    sampling = SensorSampling.of(times, 1.0, steps)
    harmonic = np.stack([np.cos(angle := 2.0 * np.pi * np.arange(steps) / per_period), np.sin(angle)], axis=1)
    exact = np.stack([np.cos(angle := 2.0 * np.pi * times / per_period), np.sin(angle)], axis=1)
    inside = (times > 4.0) & (times < 495.0)
    error = np.linalg.norm(sampling.apply(harmonic) - exact, axis=1)[inside].max()
    assert 0.1 * limit < error <= limit
    x = np.linspace(-1.0, 1.0, steps)
    at = np.interp(times, np.arange(steps), x)
    np.testing.assert_allclose(sampling.apply(x**5 - x**4)[inside], (at**5 - at**4)[inside], atol=1e-12)


@pytest.mark.parametrize(("dt", "start"), [(1.28, 0.37), (1.0, 0.37), (0.5, 0.0), (0.31, 0.2), (2.0, 3.0), (7.3, 1.1)])
def test_the_loop_computes_every_sample_once_and_in_order(dt, start):
    times, record = np.arange(start, 99.0, dt), np.random.default_rng(1).normal(size=100)
    sampling = SensorSampling.of(times, 1.0, 100)
    schedule = sampling.schedule
    window, values, order = np.zeros(schedule.weights.shape[2]), [], []
    for step, new in enumerate(record):
        window = np.append(window[1:], new)
        for slot, sample in enumerate(schedule.sample[step]):
            if sample >= 0:
                order.append(sample)
                values.append(schedule.weights[step, slot] @ window)
    order += list(schedule.late)
    values += [weights @ window for weights in schedule.late_weights]
    assert order == list(range(len(times)))
    np.testing.assert_allclose(values, sampling.apply(record), rtol=1e-10, atol=1e-12)


def test_a_polarity_is_averaged_over():
    """p(y | θ) is the mean over both directions, and predictions take the more probable one."""
    for sign in (1.0, -1.0):
        values = sign * RESPONSE[0, :, :1] + NOISE * np.random.default_rng(3).normal(size=(len(RECORD), 1))
        known = [
            si.Posterior(SPACE, MODEL, si.Observation(RECORD, values, ("velocity",), polarity=word), KERNELS["ar1"][0])
            for word in ("normal", "reversed")
        ]
        unknown = si.Posterior(
            SPACE, MODEL, si.Observation(RECORD, values, ("velocity",), polarity="unknown"), KERNELS["ar1"][0]
        )
        expected = np.logaddexp(*[of.log_density(THETA) for of in known]) - np.log(2.0)
        np.testing.assert_allclose(unknown.log_density(THETA), expected, rtol=1e-12)
        np.testing.assert_allclose(unknown.given([RESPONSE]).log_density(THETA), expected, rtol=1e-12)
        np.testing.assert_allclose(unknown.predict(THETA)[:, :, 0], sign * RESPONSE[:, :, 0], rtol=1e-12)
        better = known[0] if sign > 0.0 else known[1]
        np.testing.assert_allclose(unknown.misfit(THETA), better.misfit(THETA), rtol=1e-12)


def test_a_signal_of_noise_leaves_the_direction_open():
    """With the sensor's signal far below its noise, both directions count: the density is higher than that of one by log cosh."""
    values = 1e-6 * RESPONSE[0, :, :1]
    of = [
        si.Posterior(
            SPACE, MODEL, si.Observation(RECORD, values, ("velocity",), polarity=word), si.IID(variance=1.0)
        ).log_density(THETA)
        for word in ("normal", "reversed", "unknown")
    ]
    gap = 0.5 * (of[0] - of[1])
    np.testing.assert_allclose(of[2], 0.5 * (of[0] + of[1]) + np.log(np.cosh(gap)), rtol=1e-12)


def test_a_logger_drifts():
    """offset + drift · t, in time of the record, at the sensor's own samples."""
    observation = sensor(
        1.0 / 64.0, 0.123, offset=si.Normal(0.0, 0.01, unit="m/s"), drift=si.Normal(0.0, 0.01, unit="m/s^2")
    )
    of = si.Posterior(SPACE, MODEL, observation, si.IID())
    assert of.names == ("stiffness", "alpha", "offset", "drift", "sigma2")
    plain = np.column_stack([THETA, np.zeros((3, 2)), np.ones(3)])
    moved = plain + np.array([0.0, 0.0, 0.02, -0.003, 0.0])
    difference = (of.predict(moved) - of.predict(plain))[:, :, 0]
    np.testing.assert_allclose(difference, np.tile(0.02 - 0.003 * observation.time, (3, 1)), atol=1e-12)


def test_a_time_shift_delays_with_the_order_of_the_polynomial():
    """An unknown shift and a known start give the same prediction."""
    shifted = sensor(1.0 / 64.0, 0.123, time_shift=si.Normal(0.0, 0.05, unit="s"))
    of = si.Posterior(SPACE, MODEL, shifted, si.IID())
    predicted = of.predict(np.column_stack([THETA, np.full(3, 0.0173), np.ones(3)]))[0, 20:-20, 0]
    expected = at_times(shifted.time[20:-20] - 0.0173)
    np.testing.assert_allclose(predicted, expected, atol=1e-4 * np.abs(expected).max())


def test_samples_outside_the_record_are_left_out_and_counted():
    times = -0.37 + np.arange(1500) / 200.0
    values = np.where((times >= 0.0) & (times <= RECORD.time[-1]), at_times(np.clip(times, 0.0, RECORD.time[-1])), 99.0)
    observation = si.Observation(RECORD, values, ("velocity",), dt=1.0 / 200.0, start=-0.37)
    assert observation.left_out == (74, 1500 - 74 - len(observation.values))
    assert observation.time[0] == pytest.approx(0.0, abs=1e-9) and observation.time[-1] <= RECORD.time[-1] + 1e-9
    assert observation.peaks[0] < 1.0
    assert "74 samples before the record left out" in str(observation)


def test_a_standard_deviation_is_that_of_the_dense_covariance():
    """The posterior of a stiffness, sampled, and by quadrature of the dense density of the measured values."""
    space = si.ParameterSpace(stiffness=SPACE.marginals["stiffness"])
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma_ratio=0.2, alpha=0.05, free=("stiffness",))
    observation, (error_model, covariance) = sensor(1.0 / 64.0, 0.123), KERNELS["ar1"]
    of = si.Posterior(space, model, observation, error_model)
    known = observation.is_measured[:, 0]
    times = observation.time[known]
    dense = covariance(np.abs(np.subtract.outer(times, times)).round(12))
    grid = np.linspace(7.2e6, 7.4e6, 401)[:, None]
    errors = observation.values[known, 0] - of.predict(grid)[:, known, 0]
    log_density = scipy.stats.multivariate_normal(np.zeros(known.sum()), dense).logpdf(errors) + space.log_density(grid)
    weights = np.exp(log_density - log_density.max())
    mean = np.average(grid[:, 0], weights=weights)
    sd = np.sqrt(np.average((grid[:, 0] - mean) ** 2, weights=weights))
    result = si.sample(of, si.SMC(particles=300, steps=30, effective_share=0.5, correlation=0.3, scouts=0), seed=1)
    draws = result.thinned(20_000)[:, 0]
    assert abs(draws.mean() - mean) < 0.05 * sd
    assert draws.std() == pytest.approx(sd, rel=0.05)


def test_a_gap_says_more_than_zeros():
    """The same gap filled with zeros, as a logger without a signal does, moves the posterior by many standard deviations."""
    values = RESPONSE[0, :, :1] + NOISE * np.random.default_rng(4).normal(size=(len(RECORD), 1))
    strong = slice(200, 320)
    densities = {}
    for filled in (np.nan, 0.0):
        gap = values.copy()
        gap[strong] = filled
        of = si.Posterior(SPACE, MODEL, si.Observation(RECORD, gap, ("velocity",)), si.IID(variance=NOISE**2))
        grid = np.column_stack([np.linspace(6.5e6, 8.0e6, 301), np.full(301, THETA[0, 1])])
        densities[filled == 0.0] = grid[np.argmax(of.log_density(grid)), 0]
    assert abs(densities[False] / THETA[0, 0] - 1.0) < 0.01 < abs(densities[True] / THETA[0, 0] - 1.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: si.Observation(RECORD, np.zeros(100)), "100 samples, but the record has 601.*Give start"),
        (lambda: si.Observation(RECORD, np.zeros(100), dt=0.02), "100 samples.*time steps: 0.02 s and 0.01 s"),
        (lambda: si.Observation(RECORD, np.zeros(100), dt=0.02, start=9.0), "from 9 to 10.98 s"),
        (lambda: si.Observation(RECORD, np.full(601, np.nan)), "0 values within the record"),
        (lambda: si.Observation(RECORD, np.full(601, np.inf)), "601 infinite values.*NaN for a missing value"),
        (lambda: si.Observation(RECORD, np.ones(601), polarity="down"), "down"),
        (
            lambda: si.Observation(RECORD, np.ones((601, 2)), CHANNELS, polarity="unknown"),
            "2 channels.*its own Observation",
        ),
    ],
)
def test_bad_sensors_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_an_error_model_without_masks_refuses_gaps():
    class Plain(si.IID):
        takes_gaps = False

    with pytest.raises(InputError, match=r"missing values.*Plain.*takes_gaps"):
        si.Posterior(SPACE, MODEL, SENSORS["times of the record"](), Plain())
