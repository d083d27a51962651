"""A frame with a hysteretic law for each storey: beside one storey, linear frames, another integrator, and its mistakes."""

import numpy as np
import pytest
from scipy import linalg

import structid as si

RECORD = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(4.0)
STIFFNESS = np.array([22e6, 19e6, 16e6])
MASS, YIELD, HARDENING = 12e3, 60e3, 0.05
NOTHING = np.zeros((1, 0))


def frame(**changed):
    given = {
        "laws": ["bilinear", "linear", "linear"],
        "mass": MASS,
        "values": {"stiffness": list(STIFFNESS), "yield_force_1": YIELD, "hardening_1": HARDENING},
        "damping_ratio": 0.03,
        "channels": ("absolute_acceleration_3", "drift_1", "restoring_force_1", "displacement_3"),
    }
    return si.HystereticFrame(**(given | changed))


def relative(a, b):
    return np.abs(a - b).max(axis=0) / np.abs(b).max(axis=0)


@pytest.mark.parametrize(("law", "further"), [("bilinear", {}), ("bouc_wen", {}), ("masing", {"sharpness": 2.0})])
def test_one_storey_is_the_oscillator(law, further):
    values = {"stiffness": "20 kN/mm", "yield_force": "60 kN"} | further
    channels = ("displacement", "absolute_acceleration", "restoring_force", "absorbed_energy")
    one = si.HystereticFrame(
        [law], mass=MASS, values=values, damping_ratio=0.03, channels=tuple(f"{c}_1" for c in channels)
    )
    alone = si.Hysteretic(law, values, mass=MASS, damping_ratio=0.03, channels=channels)
    a, b = (model.simulate(NOTHING, RECORD).values[0] for model in (one, alone))
    assert (relative(a, b) < 1e-12).all()


@pytest.mark.parametrize("damping", ["modal", "rayleigh"])
def test_linear_storeys_are_the_linear_shear_frame(damping):
    channels = ("displacement_3", "absolute_acceleration_2", "drift_1", "base_shear", "velocity_3")
    linear = si.HystereticFrame(
        ["linear"] * 3,
        mass=[12e3, 11e3, 10e3],
        values={"stiffness": STIFFNESS},
        damping_ratio=0.03,
        damping=damping,
        channels=channels,
    )
    smooth = si.ShearFrame(
        storeys=3,
        mass=[12e3, 11e3, 10e3],
        stiffness=STIFFNESS,
        alpha=1.0,
        beta=1.0,
        gamma=0.0,
        damping_ratio=0.03,
        damping=damping,
        channels=channels,
    )
    a, b = (model.simulate(NOTHING, RECORD).values[0] for model in (linear, smooth))
    assert (relative(a, b) < 1e-12).all()


def central_differences(parts):
    """The same frame by explicit central differences, with many steps in a sample."""
    to_drifts = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
    damping = 0.06 * np.real(linalg.sqrtm(to_drifts.T @ np.diag(STIFFNESS) @ to_drifts / MASS))
    step = RECORD.dt / parts
    ground = np.interp(np.arange((len(RECORD.values) - 1) * parts + 1) * step, RECORD.time, RECORD.values)
    u, v, plastic, slope = np.zeros(3), np.zeros(3), 0.0, (1.0 - HARDENING) * STIFFNESS[0]
    acceleration, rows = -ground[0] * np.ones(3), []
    for k in range(len(ground)):
        drift = to_drifts @ u
        trial = slope * (drift[0] - plastic)
        hysteretic = np.clip(trial, -(1.0 - HARDENING) * YIELD, (1.0 - HARDENING) * YIELD)
        plastic += (trial - hysteretic) / slope
        shear = STIFFNESS * drift
        shear[0] = HARDENING * STIFFNESS[0] * drift[0] + hysteretic
        if k:
            acceleration = -ground[k] - damping @ half - to_drifts.T @ shear / MASS
            v = half + 0.5 * step * acceleration
        if k % parts == 0:
            rows.append([acceleration[2] + ground[k], drift[0], shear[0], u[2]])
        half = v + 0.5 * step * acceleration
        u = u + step * half
    return np.array(rows)


def test_another_integrator_gives_the_same_response():
    model = frame(substeps=6).simulate(NOTHING, RECORD).values[0]
    coarse, fine = (relative(central_differences(parts), model) for parts in (15, 60))
    assert (fine < 3e-3).all()
    assert fine[1] < 0.5 * coarse[1]


def test_vector_code_and_jax_agree(monkeypatch):
    free = ("stiffness_1", "yield_force_1", "mass_2", "damping_ratio", "stiffness")
    model = frame(mass=None, values={"hardening_1": 0.05}, free=(*free, "mass_1", "mass_3"))
    theta = np.array([[22e6, 60e3, 11e3, 0.03, 18e6, 12e3, 10e3], [20e6, 50e3, 12e3, 0.02, 17e6, 12e3, 11e3]])
    lanes = model.simulate(theta, RECORD).values
    monkeypatch.setenv("STRUCTID_ENGINE", "jax")
    np.testing.assert_allclose(model.simulate(theta, RECORD).values, lanes, rtol=1e-9, atol=1e-9 * np.abs(lanes).max())


def test_the_work_of_the_first_storey_is_the_area_of_its_loop():
    runs = frame(channels=("drift_1", "restoring_force_1", "absorbed_energy_1"), substeps=10).simulate(NOTHING, RECORD)
    drift, force, work = runs.values[0].T
    assert work[-1] == pytest.approx(np.trapezoid(force, drift), rel=0.01)
    assert set(frame().loop_channels) == {"storey 1", "storey 2", "storey 3"}


def test_numbered_names_override_plain_ones():
    values = {"stiffness_2": "19 kN/mm", "stiffness": "20 kN/mm", "yield_force": "60 kN"}
    model = frame(values=values)
    assert [law.stiffness for law in model.laws] == [20e6, 19e6, 20e6]
    assert model.laws[0].yield_force == 60e3
    assert frame(values=values).content_hash == model.content_hash
    assert frame(values=values | {"stiffness_3": 16e6}).content_hash != model.content_hash
    assert model.recording("base_shear").content_hash == model.recording("base_shear").content_hash
    assert model.natural_frequency(NOTHING) == pytest.approx([2.8], rel=0.1)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"laws": []}, "0 storeys"),
        ({"laws": ["bilinaer", "linear", "linear"]}, "bilinear"),
        ({"mass": None}, "no mass"),
        ({"mass": [1.0, 2.0]}, "3 positive numbers"),
        ({"mass": -1.0}, "positive"),
        (
            {"laws": ["bilinear", "linear"], "mass": [1.0, 2.0, 3.0]},
            "2 laws and 3 masses. Expected: a law for each storey",
        ),
        ({"free": ("stiffness_4",)}, "3 laws, and 'stiffness_4' for storey 4. Expected: a law for each storey"),
        ({"free": ("yield_force_x",)}, "yield_force_x"),
        ({"free": ("mass_1",)}, "value and is also free"),
        ({"free": ("stiffness_1",)}, "value and is also free"),
        ({"values": {"stiffness": 2e7}}, "yield_force_1"),
        ({"values": {"stiffness": [2e7, 2e7]}}, "2 values"),
        ({"values": {"yield_force_2": 6e4}}, "yield_force_2"),
        ({"values": {"stiffness": "20 kN"}}, "kN"),
        ({"channels": ("drift_4",)}, "drift_4"),
        ({"damping": "rayliegh"}, "rayleigh"),
        ({"damping": np.eye(2)}, r"\(3, 3\)"),
        ({"damping_ratio": -0.1}, "damping_ratio"),
        ({"substeps": 0}, "substeps"),
    ],
)
def test_a_mistake_is_named(changed, said):
    with pytest.raises(si.InputError, match=said):
        frame(**changed)


def test_imposed_displacements_are_refused():
    with pytest.raises(si.InputError, match="imposed displacement"):
        frame().simulate(NOTHING, si.DisplacementHistory(np.linspace(0.0, 0.01, 50), 0.01))
