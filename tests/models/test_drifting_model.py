"""Parameters that drift: the model itself where they do not, a plain integration where they do."""

import numpy as np
import pytest

import structid as si
from oscillators import DEGRADING
from structid.core.errors import InputError
from structid.models.drifting_model import DriftingModel

pytestmark = pytest.mark.quick

RECORD = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 6.0).scale_to_pga(2.0)
SPACE = si.ParameterSpace(stiffness=si.Uniform(6.5, 8.5, unit="kN/mm"), alpha=si.Uniform(0.0, 0.2))
LAW = dict(mass=12_000.0, damping_ratio=0.03, beta=60.0, gamma=30.0)


def oscillator(**more):
    return si.BoucWen(**LAW, free=SPACE.names, channels=("velocity", "restoring_force"), substeps=1, **more)


@pytest.mark.parametrize("kind", ["oscillator", "degrading", "frame"])
def test_without_drift_it_is_the_model(kind):
    model = {
        "oscillator": oscillator,
        "degrading": lambda: oscillator(delta_nu=DEGRADING["delta_nu"], delta_eta=DEGRADING["delta_eta"]),
        "frame": lambda: si.ShearFrame(
            storeys=2, **LAW, free=SPACE.names, channels=("velocity_1", "drift_2"), damping="rayleigh"
        ),
    }[kind]()
    theta = SPACE.sample(3, seed=1).values
    drift = np.concatenate([theta, np.zeros((3, 2)), np.ones((3, 8))], axis=1)
    expected, found = model.simulate(theta, RECORD), DriftingModel(model, SPACE, 4, 1.0).simulate(drift, RECORD)
    scale = np.abs(expected.values).max(axis=(0, 1))
    assert (np.abs(found.values - expected.values) <= 1e-12 * scale).all()
    assert found.units == expected.units


def test_with_drift_it_is_a_plain_integration_with_the_parameters_of_the_time():
    mean, drift, at = np.array([7.5e6, 0.06]), np.array([3e5, 0.02]), np.array([[0.0, -1.0, -0.5], [1.0, 0.0, -9.0]])
    row = np.concatenate([mean, drift, at.ravel()])
    found = DriftingModel(oscillator(), SPACE, 3, 1.5).simulate(row[None], RECORD).values[0]

    at_knots = np.clip((mean[:, None] + drift[:, None] * at).T, *SPACE.bounds.T).T
    assert at_knots[1, 2] == 0.0, "the last knot would lie below the prior"
    y, h, expected = np.zeros(3), RECORD.dt, np.zeros_like(found)
    ground = RECORD.values
    for i in range(len(RECORD)):
        stiffness, alpha = (np.interp(i * h, [0.0, 1.5, 3.0], values) for values in at_knots)
        square = stiffness / LAW["mass"]

        def rate(y, a_g, square=square, alpha=alpha):
            u, v, z = y
            force = alpha * square * u + (1.0 - alpha) * square * z
            slope = v - LAW["beta"] * abs(v) * z - LAW["gamma"] * v * abs(z)
            return np.array([v, -a_g - 2.0 * LAW["damping_ratio"] * np.sqrt(square) * v - force, slope])

        expected[i] = y[1], LAW["mass"] * square * (alpha * y[0] + (1.0 - alpha) * y[2])
        if i + 1 < len(RECORD):
            a0, a2 = ground[i], ground[i + 1]
            k1 = rate(y, a0)
            k2 = rate(y + h / 2 * k1, (a0 + a2) / 2)
            k3 = rate(y + h / 2 * k2, (a0 + a2) / 2)
            k4 = rate(y + h * k3, a2)
            y = y + h / 6 * (k1 + 2 * (k2 + k3) + k4)
    assert (np.abs(found - expected) <= 1e-11 * np.abs(expected).max(axis=0)).all(), np.abs(found - expected).max(
        axis=0
    )


@pytest.mark.parametrize("stands_for", ["external", "surrogate"])
def test_what_is_no_loop_over_time_is_refused(stands_for):
    model = oscillator()
    if stands_for == "external":
        other = si.CallableModel(lambda parameters, record: record.values, SPACE.names, ("velocity",))
    else:
        other = si.PODPCE(limit=1.0).fit(si.Campaign(model, RECORD, SPACE.sample(30, seed=1)).run())
    with pytest.raises(InputError, match=r"drifting parameters.*(derivatives|no loop over time)"):
        DriftingModel(other, SPACE, 4, 1.0)
