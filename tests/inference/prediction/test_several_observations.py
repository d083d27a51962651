"""Predictions where several observations share a record or a channel: errors are those of the observation that measured it."""

from itertools import permutations

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError
from structid.inference.prediction.prediction import predict

RECORD = si.GroundMotion.synthetic(seed=8, duration=4.0).scale_to_pga(1.8)
OTHER = si.GroundMotion.synthetic(seed=9, duration=4.0).scale_to_pga(1.8)
SPACE = si.ParameterSpace(stiffness=si.Normal(7.4, 0.2, unit="kN/mm"))
CHANNELS = ("velocity", "displacement", "absolute_acceleration")
MODEL = si.BoucWen(
    mass=12e3, damping_ratio=0.03, alpha=0.05, beta=60.0, gamma=30.0, free=SPACE.names, channels=CHANNELS
)
CLEAN = MODEL.simulate([[7.4e6]], RECORD)
SHARES = dict(zip(CHANNELS, (0.01, 0.05, 0.2), strict=True))
"""Standard deviation of each channel's noise over its own."""


def observation(channel, record=RECORD, **more):
    clean = MODEL.simulate([[7.4e6]], record).channel(channel)[0]
    seed = 5 + CHANNELS.index(channel)
    noise = SHARES[channel] * clean.std() * np.random.default_rng(seed).standard_normal(clean.shape)
    return si.Observation(record, clean + noise, (channel,), **more)


def posterior(*observations):
    return si.Posterior(SPACE, MODEL, list(observations), si.IID())


def draws(of, count=400):
    """Stiffness near the truth, and the variances that the noise has."""
    rng = np.random.default_rng(1)
    columns = []
    for name in of.names:
        if name == "stiffness":
            columns.append(rng.normal(7.4e6, 2e4, count))
        else:
            number = int(name.rpartition("_")[2]) - 1 if name[-1].isdigit() and "_" in name else 0
            own = of.observations[number]
            columns.append(np.full(count, (SHARES[own.channels[0]] * CLEAN.channel(own.channels[0])[0].std()) ** 2))
    return np.column_stack(columns)


@pytest.mark.parametrize("order", list(permutations(CHANNELS)))
def test_every_channel_has_its_own_errors_in_any_order(order):
    of = posterior(*(observation(channel) for channel in order))
    theta = draws(of)
    for index, channel in enumerate(order):
        found = predict(of, theta, observation=index, scaled=False, seed=index)
        assert found.channels == (channel,)
        error = (found.observable - found.response)[:, :, 0]
        expected = SHARES[channel] * CLEAN.channel(channel)[0].std()
        # The standard error of a standard deviation of n independent values is sd/√(2n).
        assert abs(error.std() / expected - 1.0) < 5.0 / np.sqrt(2 * error.size)
    whole = predict(of, theta, RECORD, scaled=False)
    assert whole.channels == order
    for place, channel in enumerate(order):
        expected = SHARES[channel] * CLEAN.channel(channel)[0].std()
        assert abs((whole.observable - whole.response)[:, :, place].std() / expected - 1.0) < 0.02


def test_one_observation_is_predicted_as_when_it_is_alone():
    """To the last bit: the others take no random number away."""
    alone = posterior(observation("velocity"))
    both = posterior(observation("velocity"), observation("displacement"))
    theta = draws(both)
    expected = predict(alone, theta[:, :2])
    for found in (predict(both, theta, observation=0), predict(both, theta, RECORD, ("velocity",))):
        np.testing.assert_array_equal(found.observable, expected.observable)
        np.testing.assert_array_equal(found.peaks, expected.peaks)


def test_another_record_has_the_channels_and_errors_of_all_observations():
    of = posterior(observation("velocity"), observation("absolute_acceleration", OTHER))
    third = RECORD.scale(1.0)
    found = predict(of, draws(of), third, seed=3)
    assert found.channels == ("velocity", "absolute_acceleration") and found.peak_ratio.shape == (2,)
    sizes = [
        (found.observable - found.response)[:, :, place].std() / CLEAN.channel(channel)[0].std()
        for place, channel in enumerate(found.channels)
    ]
    assert 0.003 < sizes[0] < 0.03 < 0.1 < sizes[1] < 0.4
    # A channel that is measured on another record only has its errors here, too, and the instrument of none.
    here = predict(of, draws(of), RECORD, ("velocity", "absolute_acceleration", "displacement"), scaled=False)
    errors = here.observable - here.response
    assert errors[:, :, 0].any() and errors[:, :, 1].any() and not errors[:, :, 2].any()


def test_instruments_are_those_of_the_observation():
    of = posterior(observation("velocity"), observation("displacement", gain=si.Normal(1.0, 0.1)))
    assert of.names == ("stiffness", "sigma2_1", "gain_2", "sigma2_2")
    theta = np.insert(draws(posterior(observation("velocity"), observation("displacement"))), 2, 3.0, axis=1)
    plain = MODEL.recording("displacement").simulate(theta[:, :1], RECORD).values
    np.testing.assert_allclose(predict(of, theta, observation=1, scaled=False).response, 3.0 * plain, rtol=1e-12)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"observation": 2}, "index 2. Expected: an index from 0 to 1"),
        ({"observation": 1, "record": OTHER}, "and another record"),
    ],
)
def test_an_observation_that_is_not_there(more, words):
    of = posterior(observation("velocity"), observation("displacement"))
    with pytest.raises(InputError, match=words):
        predict(of, draws(of), **more)
