"""Actuators that follow late, sensors that see with noise, compensation and indicators against closed forms."""

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.hybrid.control.compensation import AdaptiveTimeSeries, PolynomialExtrapolation
from structid.hybrid.control.motion import continuous_motion, ramp_and_hold
from structid.hybrid.control.tracking import (
    energy_error,
    frequency_evaluation_index,
    root_mean_square_error,
    tracking_indicator,
)
from structid.hybrid.control.transfer_system import Actuator, Sensor, TransferSystem

pytestmark = pytest.mark.quick
STEP = 1e-3


def followed(path, **settings):
    return TransferSystem((Actuator(**settings),), STEP).followed(np.asarray(path, dtype=float)[:, None])[:, 0]


def wave(hertz=1.0, count=8000):
    return np.sin(2.0 * np.pi * hertz * STEP * np.arange(1, count + 1))


# --- actuators ------------------------------------------------------------------------------------------------------


def test_a_whole_delay_shifts():
    np.testing.assert_array_equal(followed(wave(), delay=0.030)[30:], wave()[:-30])


def test_a_lag_is_exact_for_commands_that_are_held():
    path = np.random.default_rng(1).normal(size=400)
    fine, place, found = 1000, 0.0, []
    for command in path:  # u′ = (c − u)/T by small steps of the exact solution for a constant command
        for _ in range(fine):
            place += (command - place) * -np.expm1(-STEP / fine / 0.007)
        found.append(place)
    np.testing.assert_allclose(followed(path, lag=0.007), found, rtol=0.0, atol=1e-12)


def test_a_delay_of_parts_of_a_step():
    path = np.random.default_rng(2).normal(size=300)
    parts = 4  # the same held commands on a clock that is four times as fine, on which the delay is whole
    finer = TransferSystem((Actuator(delay=0.00275, lag=0.005),), STEP / parts)
    theirs = finer.followed(np.repeat(path, parts)[:, None])[parts - 1 :: parts, 0]
    np.testing.assert_allclose(followed(path, delay=0.00275, lag=0.005), theirs, rtol=0.0, atol=1e-13)


def test_a_lag_acts_as_a_delay_that_is_half_a_step_shorter():
    slope = 0.01 * np.arange(1.0, 2001.0)
    behind = (slope - followed(slope, lag=0.02))[-1] / 0.01 * STEP
    assert behind == pytest.approx(0.02 - STEP / 2.0, rel=1e-3)


def test_paths_may_come_in_pieces():
    system = TransferSystem((Actuator(delay=0.0042, lag=0.003, velocity=3.0),), STEP)
    pieces = [system.followed(part[:, None])[:, 0] for part in np.split(wave(2.0, 900), [1, 10, 400])]
    whole = followed(wave(2.0, 900), delay=0.0042, lag=0.003, velocity=3.0)
    np.testing.assert_allclose(np.concatenate(pieces), whole, rtol=0.0, atol=1e-15)


def test_limits_of_stroke_and_velocity():
    far = followed(2.0 * wave(), stroke=0.5, velocity=2.0)
    assert np.abs(far).max() == 0.5
    assert np.abs(np.diff(far, prepend=0.0)).max() <= 2.0 * STEP * (1.0 + 1e-12)
    np.testing.assert_allclose(followed(wave(), velocity=6.3), wave(), rtol=0.0, atol=1e-12)


def test_a_sensor_has_noise_and_steps():
    system = TransferSystem(
        (Actuator(displacement_sensor=Sensor(1e-5), force_sensor=Sensor(range=1e6, bits=10)),), STEP
    )
    seen, force = system.seen(np.zeros((20_000, 1)), np.full((20_000, 1), 1234.5))
    assert seen.std() == pytest.approx(1e-5, rel=5.0 / np.sqrt(40_000))
    assert set(force.ravel()) == {1e6 / 1024.0}
    again = TransferSystem((Actuator(displacement_sensor=Sensor(1e-5)),), STEP, seed=1).seen(
        np.zeros((9, 1)), np.zeros((9, 1))
    )[0]
    assert not np.array_equal(seen[:9], again)


# --- compensation ---------------------------------------------------------------------------------------------------


def compensated(compensation, path, **settings):
    """Commands and places of a continuous motion, a controller step at a time."""
    system = TransferSystem((Actuator(**settings),), STEP)
    compensator = compensation.begin(1, STEP, 10.0)
    places = []
    for target in path:
        command = compensator.commands(np.array([[target]]))
        places.append(system.followed(command)[0])
        seen = system.seen(places[-1][None], np.zeros((1, 1)))[0]
        compensator.observe(command, seen)
    return np.array(places)[:, 0], compensator


@pytest.mark.parametrize("order", range(6))
def test_a_polynomial_of_its_order_is_followed_exactly(order):
    time = STEP * np.arange(-2000.0, 1.0)
    path = np.polynomial.polynomial.polyval(time, np.arange(1.0, order + 2.0))
    places, _ = compensated(PolynomialExtrapolation(0.02, order), path, delay=0.02)
    np.testing.assert_allclose(places[200:], path[200:], rtol=0.0, atol=1e-9)
    if order:
        lower, _ = compensated(PolynomialExtrapolation(0.02, order - 1), path, delay=0.02)
        assert np.abs(lower[200:] - path[200:]).max() > 1e-8


@pytest.mark.parametrize("order", range(4))
def test_the_gain_is_that_of_the_loop(order):
    hertz, delay = 4.0, 0.02
    omega = 2.0 * np.pi * hertz
    places, _ = compensated(PolynomialExtrapolation(delay, order), wave(hertz), delay=delay)
    basis = np.exp(1j * omega * STEP * np.arange(1, 8001))[4000:]
    factor = np.linalg.lstsq(np.column_stack([basis.imag, basis.real]), places[4000:], rcond=None)[0]
    closed = 1.0 - (1.0 - np.exp(-1j * omega * delay)) ** (order + 1)
    gain = PolynomialExtrapolation(delay, order).gain(omega, delay) * np.exp(-1j * omega * delay)
    assert gain == pytest.approx(closed, abs=1e-12)
    assert complex(*factor) == pytest.approx(closed, abs=1e-9)


def test_where_extrapolation_adds_damping():
    for order, ends in ((3, np.pi / 2.0), (2, np.pi / 3.0)):
        factor = lambda angle, n=order: PolynomialExtrapolation(1.0, n).gain(angle, 1.0) * np.exp(-1j * angle)  # noqa: E731
        assert min(factor(angle).imag for angle in np.linspace(0.01, ends - 0.01, 50)) > 0.0
        assert factor(ends + 0.05).imag < 0.0
    for order in (0, 1):
        assert PolynomialExtrapolation(1.0, order).gain(0.2, 1.0).imag - 0.2 < 0.0


def test_noise_grows_by_the_root_of_the_squares():
    assert np.linalg.norm(PolynomialExtrapolation(0.01).weights) == pytest.approx(8.3, abs=0.01)


@pytest.mark.parametrize("noise", [0.0, 5e-6])
def test_a_series_finds_the_delay_from_a_wrong_start(noise):
    time = STEP * np.arange(20_000)
    path = 0.02 * np.sin(2.0 * np.pi * 0.25 * time) * np.sin(2.0 * np.pi * 0.03 * time)
    sensor = Sensor(noise)
    places, compensator = compensated(AdaptiveTimeSeries(0.02), path, delay=0.03, displacement_sensor=sensor)
    assert compensator.coefficients[0] == pytest.approx([1.0, 0.03], rel=0.02)
    late, _ = compensated(PolynomialExtrapolation(0.02), path, delay=0.03)
    half = len(path) // 2
    assert root_mean_square_error(path[half:], places[half:]) < 0.3 * root_mean_square_error(path[half:], late[half:])


def test_jumps_make_no_spikes():
    path = np.where(np.arange(3000) < 1500, 0.0, 2e-5)
    compensator = AdaptiveTimeSeries(0.017).begin(1, STEP, 5.0)
    assert np.abs(compensator.commands(path[:, None])).max() < 10.0 * 2e-5


# --- indicators -----------------------------------------------------------------------------------------------------


def test_indicators_of_a_late_and_small_wave():
    dt, omega, delay, size = 1e-3, 2.0 * np.pi, 0.02, 0.9
    time = dt * np.arange(4000)
    wanted, measured = np.sin(omega * time), size * np.sin(omega * (time - delay))
    index = frequency_evaluation_index(wanted, measured, dt)
    assert (index.amplitude, index.delay, index.frequency) == pytest.approx((size, delay, 1.0), rel=1e-2)
    # ½ ∮ of an ellipse: π · size · sin(ω τ) a cycle, growing while it lags
    area = tracking_indicator(wanted, measured)
    assert area[-1] == pytest.approx(4.0 * np.pi * size * np.sin(omega * delay), rel=1e-3)
    assert tracking_indicator(measured, wanted)[-1] == pytest.approx(-area[-1])
    assert root_mean_square_error(wanted, wanted + 0.1 * wanted) == pytest.approx(0.1)


def test_a_late_elastic_specimen_feeds_energy():
    time = 1e-3 * np.arange(4001)
    wanted, measured = np.sin(2.0 * np.pi * time), np.sin(2.0 * np.pi * (time - 0.02))
    # ∮ k u_m d(u_m − u_c) = π k sin(ω τ) a cycle
    assert energy_error(5.0 * measured, wanted, measured)[-1] == pytest.approx(
        4.0 * 5.0 * np.pi * np.sin(0.04 * np.pi), rel=1e-3
    )
    assert energy_error(5.0 * wanted, measured, wanted)[-1] < 0.0


def test_nothing_to_follow():
    assert np.isnan(root_mean_square_error(np.zeros(9), np.zeros(9)))
    with pytest.raises(InputError, match="a command that is not zero"):
        frequency_evaluation_index(np.zeros(9), np.zeros(9), 1.0)


# --- motions --------------------------------------------------------------------------------------------------------


def test_a_ramp_ends_in_a_hold():
    motion = ramp_and_hold(2.0, STEP)
    path = motion.path(np.array([1.0]), np.array([3.0]))[:, 0]
    assert (len(path), motion.ramp, motion.averaged) == (2000, 1600, 200)
    np.testing.assert_array_equal(path[1599:], 3.0)
    rates = np.diff(path, prepend=1.0)
    assert rates.max() / 2.0 == pytest.approx(motion.peak_rate)
    assert motion.peak_rate == pytest.approx(1.5 / 1600.0, rel=1e-3)
    assert rates[0] < 0.01 * rates.max()


def test_a_continuous_motion_never_stops():
    path = continuous_motion(4e-3, STEP).path(np.zeros(2), np.array([4.0, 8.0]))
    np.testing.assert_allclose(path, np.outer([1.0, 2.0, 3.0, 4.0], [1.0, 2.0]))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: continuous_motion(1.5e-3, STEP), "1.5 controller steps"),
        (lambda: ramp_and_hold(2e-3, STEP), "5 or more"),
        (lambda: Actuator(delay=-1.0), "0 or more"),
        (lambda: Actuator(stroke=0.0), "a positive limit"),
        (lambda: Sensor(range=-1.0), "a positive range"),
        (lambda: TransferSystem((Actuator(),), 0.0), "a positive time"),
        (lambda: PolynomialExtrapolation(0.0), "a positive time"),
        (lambda: PolynomialExtrapolation(0.1, 7), "from 0 to 5"),
        (lambda: AdaptiveTimeSeries(0.1, window=0.0), "a positive number"),
        (lambda: AdaptiveTimeSeries(0.1, amplitudes=(1.1, 1.2)), "a range around 1"),
    ],
)
def test_what_cannot_follow_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
