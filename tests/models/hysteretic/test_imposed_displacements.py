"""Structures on which displacements are imposed: the law of the oscillator, exactly; several displacements at once; derivatives."""

import jax
import numpy as np
import pytest

from structid.core.errors import InputError
from structid.ground_motion.excitation import CombinedExcitation, DisplacementHistory, ForceHistory, RotationHistory
from structid.ground_motion.record import GroundMotion
from structid.mechanics.carried_over import CarriedOver, InPieces
from structid.mechanics.restoring_forces import HystereticSprings, LinearForce, spring_law
from structid.models.hysteretic.bouc_wen import BoucWen
from structid.models.hysteretic.imposed_displacements import ImposedDisplacements, force_channels
from structid.models.hysteretic.shear_frame import ShearFrame

pytestmark = pytest.mark.quick
LAW = {"mass": 12e3, "alpha": 0.05, "beta": 63.0, "gamma_ratio": 1.0, "delta_nu": 2.43, "delta_eta": 6.5}


def way(samples=401):
    time = np.linspace(0.0, 6.0 * np.pi, samples)
    return DisplacementHistory(0.03 * np.sin(time) * (1.0 + 0.1 * time), 1.0, "cycles")


def storey(*free, **settings):
    return BoucWen(free=free, **LAW | {"stiffness": 7.6e6} | settings)


def test_it_is_the_oscillator_without_inertia():
    fine = storey(channels=("restoring_force",), substeps=400).simulate(np.zeros((1, 0)), way()).values[0, :, 0]
    found = ImposedDisplacements(storey()).simulate(np.zeros((1, 0)), way()).values[0, :, 0]
    assert np.abs(found - fine).max() < 1e-5 * np.abs(fine).max()


def test_pieces_are_of_fourth_order():
    def error(pieces):
        return np.abs(
            ImposedDisplacements(storey(), pieces=pieces).simulate(np.zeros((1, 0)), way(101)).values - exact
        ).max()

    exact = ImposedDisplacements(storey(), pieces=128).simulate(np.zeros((1, 0)), way(101)).values
    orders = np.log2(error(8) / error(16)), np.log2(error(16) / error(32))
    assert min(orders) > 3.5, orders


def test_free_parameters_and_their_derivatives():
    model = ImposedDisplacements(storey("stiffness", "alpha", stiffness=None, alpha=None), pieces=2)
    assert model.free == ("stiffness", "alpha")
    theta, traced = np.array([[7e6, 0.1]]), model.traced(way(101))

    def last(row):
        return model.response(row[None], traced)[0][60, 0, 0]

    slope = jax.jacfwd(last)(theta[0])
    for k, step in enumerate((7e6 * 1e-6, 1e-7)):
        moved = np.zeros(2)
        moved[k] = step
        difference = float(last(theta[0] + moved) - last(theta[0] - moved)) / (2 * step)
        assert float(slope[k]) == pytest.approx(difference, rel=1e-5)


def test_channels_by_units():
    assert force_channels(["m"]) == ("restoring_force",)
    assert force_channels(["m", "m", "rad"]) == ("restoring_force_1", "restoring_force_2", "moment_3")


@pytest.mark.parametrize(
    ("excitation", "came"),
    [
        (GroundMotion(np.ones(5), 0.1), "ground_motion"),
        (ForceHistory(np.ones(5), 0.1), "force"),
        (CombinedExcitation([DisplacementHistory(np.ones(5), 0.1), RotationHistory(np.ones(5), 0.1)]), "rotation"),
    ],
)
def test_other_excitations_are_refused(excitation, came):
    with pytest.raises(InputError, match=came):
        ImposedDisplacements(storey()).simulate(np.zeros((1, 0)), excitation)


def test_a_model_without_a_static_force_is_refused():
    frame = ShearFrame(storeys=2, mass=1e4, stiffness=1e7, alpha=1.0, beta=0.0, gamma=0.0)
    with pytest.raises(InputError, match="allows imposed displacements"):
        ImposedDisplacements(frame)


# --- forces made of others ------------------------------------------------------------------------------------------


def springs():
    return HystereticSprings([[1.0]], [7.6e6], [12e3], spring_law(alpha=0.05, beta=63.0, gamma=63.0, delta_eta=5.0))


def test_a_force_with_a_past_goes_on_where_it_ended():
    places = [0.004, -0.01, 0.002, 0.006, -0.003]
    whole, memory, forces = springs(), springs().at_rest(np.zeros(1)), []
    for place in places:
        force, memory = whole.at(memory, np.array([place]))
        forces.append(force)
    carried = CarriedOver(springs(), np.array(places[:3])[:, None])
    memory = carried.at_rest(np.zeros(1))
    assert carried.begin(np.zeros(1))[0] == 0.0
    for place, force in zip(places[3:], forces[3:], strict=True):
        found, memory = carried.at(memory, np.array([place - places[2]]))
        np.testing.assert_allclose(found, force - forces[2], rtol=1e-12)


def test_pieces_go_straight():
    inner = LinearForce(np.array([[2.0, -1.0], [-1.0, 2.0]]))
    force = InPieces(inner, 3)
    found, memory = force.at(force.at_rest(np.zeros(2)), np.array([1.0, 3.0]))
    np.testing.assert_allclose(found, [-1.0, 5.0])
    np.testing.assert_allclose(memory["place"], [1.0, 3.0])
    assert force.dofs == 2 and force.units == ("m", "m")


def test_a_past_needs_a_place():
    with pytest.raises(InputError, match="place, dof"):
        CarriedOver(springs(), np.zeros((0, 1)))
