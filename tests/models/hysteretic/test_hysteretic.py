"""The model with any hysteretic law: on lanes, in JAX, in NumPy; free, forced, and under imposed displacements."""

import jax
import numpy as np
import pytest

import structid as si
from law_paths import CYCLES, TYPICAL, forces_along, path_between, random_values, typical
from structid.core.errors import InputError
from structid.engine.device import jnp
from structid.mechanics.hysteretic_laws.law_list import LAWS
from structid.models.drifting_model import DriftingModel

NOTHING = np.zeros((1, 0))
RECORD = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 7.0).scale_to_pga(2.0)
OSCILLATOR = {"stiffness": 7.6e6, "yield_force": 4e4}
SMOOTH = ("bouc_wen", "slip_lock", "voce_chaboche", "ramberg_osgood")


def storey(word: str) -> dict[str, float]:
    """Typical values for a storey: stiffness and forces of a real one, lengths in yield displacements as in the typical law."""
    values = dict(TYPICAL[word])
    length = {
        n: v * OSCILLATOR["yield_force"] / OSCILLATOR["stiffness"] / 0.1
        for n, v in values.items()
        if LAWS[word].parameters()[n].unit == "m"
    }
    strength = values.get("yield_force", 1.0) * OSCILLATOR["yield_force"]
    values |= length | {"stiffness": OSCILLATOR["stiffness"]}
    return values | ({"yield_force": strength} if "yield_force" in values else {})


@pytest.mark.parametrize("word", LAWS)
def test_lanes_jax_and_numpy_give_the_same_cyclic_forces(word):
    law, path = LAWS[word], path_between(CYCLES, 12)
    drawn = random_values(law, 5)
    names = tuple(drawn)
    theta = np.array([drawn[name] for name in names]).T
    model = si.Hysteretic(word, free=names, substeps=3)
    history = si.DisplacementHistory(np.append(0.0, path), 1.0)
    steps = model.steps_in_sample(history)
    expected = forces_along(law().with_values(drawn), np.repeat(path_between(path, steps)[:, None], 5, axis=1))[
        steps - 1 :: steps
    ]
    run = model.simulate(theta, history)
    good = run.done
    assert good.any()
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(run.values[good, 1:, 0] / scale[good, None], (expected / scale).T[good], atol=1e-10)
    values, usable = jax.jit(model.response)(jnp.asarray(theta), model.traced(history))
    np.testing.assert_array_equal(np.asarray(usable), good)
    np.testing.assert_allclose(
        np.asarray(values)[1:, 0].T[good] / scale[good, None], (expected / scale).T[good], atol=1e-10
    )


@pytest.mark.parametrize("word", LAWS)
def test_steps_converge_under_a_ground_motion(word):
    def response(substeps):
        model = si.Hysteretic(
            word,
            storey(word),
            mass=12e3,
            damping_ratio=0.03,
            channels=("displacement", "restoring_force"),
            substeps=substeps,
        )
        run = model.simulate(NOTHING, RECORD)
        assert run.done[0], run.reasons
        return run.values[0]

    exact = response(48)
    peaks = np.abs(exact).max(axis=0)
    default, finer = (np.abs(response(substeps) - exact).max(axis=0) / peaks for substeps in (3, 12))
    assert default.max() < 0.01
    assert finer.max() < max(0.6 * default.max(), 1e-5)


def test_the_bouc_wen_law_is_the_bouc_wen_model():
    """The other integrator and the other parameters: u_y = 1/(β + γ), rates per energy in place of energy per mass."""
    k, mass, beta, gamma = 7.6e6, 12e3, 40.0, 20.0
    u_y = 1.0 / (beta + gamma)
    energy = k * u_y * u_y / mass  # F_y u_y per mass
    channels = ("displacement", "restoring_force", "absorbed_energy")
    common = {"mass": mass, "damping_ratio": 0.03, "channels": channels, "substeps": 24}
    model = si.BoucWen(
        stiffness=k, alpha=0.05, beta=beta, gamma=gamma, delta_nu=2.4, delta_eta=6.0, asymmetry=0.8, **common
    )
    values = {"stiffness": k, "yield_force": k * u_y, "hardening": 0.05, "gamma_ratio": gamma / beta, "asymmetry": 0.8}
    law = si.Hysteretic("bouc_wen", values | {"delta_nu": 2.4 * energy, "delta_eta": 6.0 * energy}, **common)
    expected, found = (m.simulate(NOTHING, RECORD).values[0] for m in (model, law))
    assert (np.abs(found - expected).max(axis=0) < 1e-5 * np.abs(expected).max(axis=0)).all()


def test_a_linear_spring_is_a_linear_oscillator():
    channels = ("displacement", "velocity", "absolute_acceleration")
    linear = si.Hysteretic("linear", {"stiffness": 7.6e6}, mass=12e3, damping_ratio=0.03, channels=channels)
    bouc_wen = si.BoucWen(
        mass=12e3, damping_ratio=0.03, stiffness=7.6e6, alpha=1.0, beta=0.0, gamma=0.0, channels=channels
    )
    expected, found = (m.simulate(NOTHING, RECORD).values[0] for m in (bouc_wen, linear))
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_energy_of_an_oscillator_balances():
    """½ m v² + ∫ c v² dt + ∫ f du = ∫ p v dt, under a force p that is smooth between the samples."""
    time = 2e-3 * np.arange(2001)
    force = si.ForceHistory(6e4 * np.sin(9.0 * time) * np.minimum(time, 1.0), 2e-3)
    channels = ("velocity", "absorbed_energy")
    model = si.Hysteretic("bilinear", storey("bilinear"), mass=12e3, damping=2e4, channels=channels, substeps=8)
    velocity, absorbed = model.simulate(NOTHING, force).values[0].T

    def integral(values):
        return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])

    taken = integral(force.values * velocity)
    stored = 6e3 * velocity**2 + integral(2e4 * velocity**2) + absorbed
    assert absorbed[-1] > 0.1 * taken.max()
    # The trapezoidal rule at the samples is the largest error.
    assert np.abs(stored - taken).max() < 1e-4 * np.abs(taken).max()


def test_the_force_offset_moves_nothing():
    values = storey("masing")
    common = {"mass": 12e3, "channels": ("displacement", "restoring_force")}
    with_offset, without = (
        si.Hysteretic("masing", values, force_offset=offset, **common).simulate(NOTHING, RECORD).values[0]
        for offset in (5e3, 0.0)
    )
    np.testing.assert_array_equal(with_offset[:, 0], without[:, 0])
    np.testing.assert_allclose(with_offset[:, 1] - without[:, 1], 5e3, rtol=1e-9)


def test_the_force_of_a_cyclic_test_does_not_depend_on_its_rate():
    model = si.Hysteretic("slip_lock", TYPICAL["slip_lock"])
    slow, fast = (
        model.simulate(NOTHING, si.DisplacementHistory(path_between(CYCLES, 20), dt)).values for dt in (60.0, 0.01)
    )
    np.testing.assert_allclose(fast, slow, rtol=1e-9)


@pytest.mark.parametrize("word", LAWS)
def test_as_a_specimen_it_is_the_model(word):
    model = si.Hysteretic(word, TYPICAL[word])
    path = si.DisplacementHistory(np.append(0.0, path_between(CYCLES, 60)), 1.0)
    expected = model.simulate(NOTHING, path).values[0]
    imposed = si.ImposedDisplacements(model, pieces=model.steps_in_sample(path)).simulate(NOTHING, path).values[0]
    np.testing.assert_allclose(imposed, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("word", SMOOTH)
def test_derivatives_are_those_of_differences(word):
    names = tuple(TYPICAL[word])
    model = si.Hysteretic(word, free=names)
    traced = model.traced(si.DisplacementHistory(path_between(np.array([0.3, -0.5]), 30), 1.0))
    point = jnp.array([TYPICAL[word][name] for name in names])

    def final_forces(theta):
        return model.response(theta[None], traced)[0][::30, 0, 0]

    jacobian = np.asarray(jax.jacfwd(final_forces)(point))
    for column, value in enumerate(np.asarray(point)):
        step = np.zeros(len(names))
        step[column] = 1e-6 * max(abs(value), 1e-2)
        difference = (final_forces(point + step) - final_forces(point - step)) / (2.0 * step[column])
        np.testing.assert_allclose(
            jacobian[:, column], difference, rtol=1e-4, atol=1e-4 * np.abs(difference).max() + 1e-7
        )


def test_parameters_may_drift():
    space = si.ParameterSpace(
        stiffness=si.Uniform(6.5, 8.5, unit="kN/mm"), yield_force=si.Uniform(30.0, 50.0, unit="kN")
    )
    model = si.Hysteretic("masing", {"sharpness": 1.0}, mass=12e3, free=space.names, channels=("displacement",))
    theta = space.sample(3, seed=1).values
    drift = np.concatenate([theta, np.zeros((3, 2)), np.ones((3, 8))], axis=1)
    expected, found = (
        model.simulate(theta, RECORD).values,
        DriftingModel(model, space, 4, 1.0).simulate(drift, RECORD).values,
    )
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"law": "pivott"}, "Did you mean 'pivot'"),
        ({"law": "pivot", "values": {"yield_force": 1.0}}, "stiffness"),
        ({"law": "pivot", "values": {"stiffness": "3 kN", "yield_force": 1.0}}, "kN"),
        ({"law": "pivot", "values": {"stiffness": 1.0, "yield_force": 0.0}}, "a positive number"),
        ({"law": "pivot", "values": {"stiffness": 1.0, "yield_force": 1.0, "beta": 3.0}}, "no parameter 'beta'"),
        ({"law": "pivot", "values": {"stiffness": 1.0, "yield_force": 1.0}, "free": ("stiffness",)}, "Remove one"),
        ({"law": "bilinear", "values": TYPICAL["bilinear"] | {"hardening": 1.5}}, "0 to 1"),
        ({"law": "linear", "values": {"stiffness": 1.0}, "mass": -1.0}, "a positive number"),
    ],
)
def test_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        si.Hysteretic(**arguments)


def test_a_motion_needs_a_mass():
    with pytest.raises(InputError, match="no mass"):
        si.Hysteretic("linear", {"stiffness": 1.0}).simulate(NOTHING, RECORD)


def test_moves_that_are_too_long_are_found():
    path = si.DisplacementHistory([0.0, 0.001, -0.5, 0.5], 1.0)
    model = si.Hysteretic("bouc_wen", TYPICAL["bouc_wen"] | {"yield_force": 1e-3})
    assert not model.simulate(NOTHING, path).done[0]


def test_law_objects_are_as_good_as_names():
    path = si.DisplacementHistory(path_between(CYCLES, 5), 1.0)
    by_name, by_law = (
        si.Hysteretic(law, values).simulate(NOTHING, path).values
        for law, values in (("pivot", TYPICAL["pivot"]), (typical("pivot"), {}))
    )
    np.testing.assert_array_equal(by_name, by_law)
