import numpy as np
import pytest
import scipy.linalg
import scipy.signal

import structid as si
from oscillators import DEGRADING
from structid.core.errors import InputError

pytestmark = pytest.mark.quick

NOTHING_FREE = np.zeros((1, 0))
LAW = dict(alpha=0.05, beta=63.0, gamma_ratio=0.5)


def test_one_storey_is_the_oscillator(record):
    one = si.ShearFrame(storeys=1, **DEGRADING, channels=("displacement_1", "base_shear")).simulate(
        NOTHING_FREE, record
    )
    oscillator = si.BoucWen(**DEGRADING, channels=("displacement", "restoring_force")).simulate(NOTHING_FREE, record)
    for i in range(2):
        found, expected = one.values[0, :, i], oscillator.values[0, :, i]
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("damping", ["modal", "rayleigh"])
def test_linear_frame_equals_its_modes(record, damping):
    """Independent check: modal superposition with the exact recurrence of every mode."""
    from structid.ground_motion.spectra import oscillator_displacement

    mass, stiffness = np.array([12e3, 10e3, 8e3]), np.array([2.0e7, 1.6e7, 1.2e7])
    frame = si.ShearFrame(
        storeys=3,
        mass=mass,
        stiffness=stiffness,
        alpha=1.0,
        beta=0.0,
        gamma=0.0,
        damping_ratio=0.03,
        damping=damping,
        channels=("displacement_1", "displacement_2", "displacement_3"),
        substeps=12,
    )
    k = np.diag(stiffness + np.append(stiffness[1:], 0)) - np.diag(stiffness[1:], 1) - np.diag(stiffness[1:], -1)
    squares, modes = scipy.linalg.eigh(k, np.diag(mass))
    np.testing.assert_allclose(frame.frequencies(), np.sqrt(squares) / 2 / np.pi, rtol=1e-12)
    omega = np.sqrt(squares)
    a, b = np.linalg.solve([[0.5 / omega[0], 0.5 * omega[0]], [0.5 / omega[2], 0.5 * omega[2]]], [0.03, 0.03])
    ratios = np.full(3, 0.03) if damping == "modal" else 0.5 * (a / omega + b * omega)
    expected = np.zeros((len(record), 3))
    for i in range(3):
        participation = modes[:, i] @ mass
        fine = oscillator_displacement(record.values, record.dt, 2 * np.pi / omega[i], ratios[i])
        q = fine[:: (fine.size - 1) // (len(record) - 1)]
        expected += participation * q[:, None] * modes[:, i]
    np.testing.assert_allclose(
        frame.simulate(NOTHING_FREE, record).values[0], expected, atol=1e-5 * np.abs(expected).max()
    )


def test_shears_balance_the_floors_and_drifts_add_up(record):
    channels = [
        f"{c}_{j}"
        for j in (1, 2)
        for c in ("drift", "displacement", "velocity", "absolute_acceleration", "restoring_force")
    ]
    frame = si.ShearFrame(
        storeys=2,
        mass=12e3,
        stiffness=2e7,
        delta_nu=1.0,
        delta_eta=3.0,
        **LAW,
        damping=np.zeros((2, 2)),
        channels=(*channels, "base_shear"),
    )
    h = frame.simulate(NOTHING_FREE, record)
    c = {name: h.channel(name)[0] for name in h.channels}
    np.testing.assert_allclose(c["drift_2"], c["displacement_2"] - c["displacement_1"], atol=1e-15)
    # Without damping the base shear is minus the inertia of everything above.
    np.testing.assert_allclose(
        c["base_shear"], -12e3 * (c["absolute_acceleration_1"] + c["absolute_acceleration_2"]), atol=1e-6
    )
    np.testing.assert_array_equal(c["base_shear"], c["restoring_force_1"])


def test_numbered_and_common_parameters(short_record):
    channels = ("drift_1", "drift_2")
    fixed = si.ShearFrame(storeys=2, mass=12e3, stiffness=[2e7, 1.5e7], **LAW, channels=channels)
    numbered = si.ShearFrame(storeys=2, mass=12e3, stiffness=2e7, **LAW, free=("stiffness_2",), channels=channels)
    common = si.ShearFrame(storeys=2, mass=12e3, **LAW, free=("stiffness", "stiffness_2"), channels=channels)
    expected = fixed.simulate(NOTHING_FREE, short_record).values
    np.testing.assert_allclose(
        numbered.simulate(np.array([[1.5e7]]), short_record).values, expected, rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(
        common.simulate(np.array([[2e7, 1.5e7]]), short_record).values, expected, rtol=1e-9, atol=1e-12
    )


def test_bad_frames_are_refused():
    with pytest.raises(InputError, match="2 numbers"):
        si.ShearFrame(storeys=2, mass=[1.0, 2.0, 3.0], stiffness=1.0, **LAW)
    with pytest.raises(InputError, match="stiffness"):
        si.ShearFrame(storeys=2, mass=1.0, **LAW)
    with pytest.raises(InputError, match="Did you mean 'drift_2'"):
        si.ShearFrame(storeys=2, mass=1.0, stiffness=1.0, **LAW, channels=("drift_3",))
    for free in (("gamma_2",), ("gamma_1", "gamma_2")):
        with pytest.raises(InputError, match="exactly one of the two"):
            si.ShearFrame(storeys=2, mass=1.0, stiffness=1.0, **LAW, free=free)
    with pytest.raises(InputError, match="every storey"):
        si.ShearFrame(storeys=2, mass=1.0, stiffness=1.0, alpha=0.1, beta=1.0, free=("gamma_2",))
    with pytest.raises(InputError, match=r"ShearFrame\.beta: only beta_1 is free.*every storey"):
        si.ShearFrame(storeys=2, mass=1.0, stiffness=1.0, alpha=0.1, gamma=1.0, free=("beta_1",))
    for wrong in (np.nan, -1.0, "heavy"):
        with pytest.raises(InputError, match=r"ShearFrame[.(]mass"):
            si.ShearFrame(storeys=2, mass=wrong, stiffness=1.0, **LAW)
    with pytest.raises(InputError, match="imposed displacement"):
        si.ShearFrame(storeys=2, mass=1.0, stiffness=1.0, **LAW).simulate(
            NOTHING_FREE, si.DisplacementHistory(np.zeros(5), 0.1)
        )


def test_a_mistyped_number_of_storeys_is_refused_at_once():
    with pytest.raises(InputError, match="1 to 200"):
        si.ShearFrame(storeys=999_999_999, mass=12_000.0, stiffness=2e7, damping_ratio=0.03)
