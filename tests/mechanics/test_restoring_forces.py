"""Springs that are moved: the path's length does not matter, kinks keep the order, JAX answers alike."""

import jax
import numpy as np
import pytest

from structid.core.errors import InputError
from structid.engine.device import jnp
from structid.ground_motion.excitation import DisplacementHistory
from structid.mechanics import moved_springs
from structid.mechanics.restoring_forces import HystereticSprings, LinearForce, spring_law
from structid.models.hysteretic.bouc_wen import BoucWen

pytestmark = pytest.mark.quick
LAW = {"alpha": 0.05, "beta": 63.0, "gamma": 63.0, "delta_nu": 2.43, "delta_eta": 6.5}


def storey(**law):
    return HystereticSprings([[1.0]], [7.6e6], [12_000.0], spring_law(**LAW | law))


def path(samples=301):
    time = np.linspace(0.0, 3.0, samples)
    return 0.04 * np.sin(2.0 * np.pi * time) * time / 3.0


def forces(springs, places):
    memory, found = springs.at_rest(np.zeros(1)), []
    for place in places:
        force, memory = springs.at(memory, np.array([place]))
        found.append(force[0])
    return np.array(found)


def cut(places, parts):
    """The same path in smaller moves."""
    ends = np.interp(np.arange((len(places) - 1) * parts + 1) / parts, np.arange(len(places)), places)
    return ends[1:]


def test_smaller_moves_come_to_the_same():
    places = path(2401)  # moves of up to 0.3 mm
    whole, fine = forces(storey(), places[1:]), forces(storey(), cut(places, 7))[6::7]
    assert np.abs(whole - fine).max() < 1e-9 * np.abs(fine).max()


def test_without_the_split_at_the_kink_it_would_not(monkeypatch):
    places = path(2401)
    fine = forces(storey(), cut(places, 7))[6::7]
    monkeypatch.setattr(moved_springs, "crosses_zero", lambda before, after: np.zeros(before.shape, dtype=bool))
    unsplit = forces(storey(), places[1:])
    assert np.abs(unsplit - fine).max() > 1e-8 * np.abs(fine).max()


def test_moves_are_of_fourth_order_across_kinks():
    exact = forces(storey(), cut(path(121), 64))[-1]
    errors = [abs(forces(storey(), cut(path(121), parts))[-1] - exact) for parts in (1, 2, 4)]
    assert errors[0] / errors[1] > 11.0
    assert errors[1] / errors[2] > 11.0


def test_the_oscillator_driven_by_displacements_gives_the_same_force():
    places = path()
    model = BoucWen(mass=12_000.0, stiffness=7.6e6, channels=("restoring_force",), substeps=40, **LAW)
    theirs = model.simulate(np.zeros((1, 0)), DisplacementHistory(places, 0.01)).values[0, :, 0]
    ours = forces(storey(), places[1:])
    np.testing.assert_allclose(ours, theirs[1:], rtol=0.0, atol=2e-6 * np.abs(theirs).max())


@pytest.mark.parametrize(
    "law", [{}, {"exponent": 2.3}, {"zeta0": 0.9, "p": 1.0, "q": 0.1, "psi0": 0.02, "lambda_": 0.5}]
)
def test_jax_answers_alike_for_many_runs(law):
    springs = HystereticSprings([[1.0, 0.0], [-1.0, 1.0]], [7.6e6, 5e6], [12e3, 10e3], spring_law(**LAW | law))
    scales = np.array([0.5, 1.0, 1.5])
    places = path(481)[:, None, None] * np.array([1.0, 1.7])[:, None] * scales

    def step(memory, place):
        force, memory = springs.at(memory, place)
        return memory, force

    many = jax.lax.scan(step, springs.at_rest(jnp.zeros((2, 3))), jnp.asarray(places))[1]
    for run in range(3):
        memory = springs.at_rest(np.zeros(2))
        for place, theirs in zip(places[..., run], many[..., run], strict=True):
            force, memory = springs.at(memory, place)
            np.testing.assert_allclose(force, theirs, rtol=1e-10, atol=1e-6)


def test_a_closed_path_of_a_linear_spring_takes_no_energy():
    law = storey(beta=0.0, gamma=0.0, delta_nu=0.0, delta_eta=0.0)
    np.testing.assert_allclose(forces(law, path()[1:]), 7.6e6 * path()[1:], rtol=1e-12, atol=1e-6)


def test_a_linear_force():
    force, memory = LinearForce(np.array([[2.0, -1.0], [-1.0, 1.0]])).at((), np.array([1.0, 3.0]))
    np.testing.assert_array_equal(force, [-1.0, 2.0])
    assert memory == ()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: HystereticSprings([[1.0]], [7.6e6, 1.0], [12e3], spring_law(**LAW)), "1 positive numbers"),
        (lambda: HystereticSprings([[1.0]], [-1.0], [12e3], spring_law(**LAW)), "1 positive numbers"),
        (lambda: spring_law(0.05, 63.0, 63.0, delta=1.0), "'delta'"),
    ],
)
def test_springs_that_cannot_be_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
