"""A wall that a rigid beam moves slowly: in equilibrium, as stiff as finite elements say, and never a source of energy."""

import jax
import numpy as np
import pytest

from structid.hybrid.substructures.reduction import constraint_modes
from structid.mechanics.cohesive_laws import JOINT_LAWS, cohesive_law
from structid.mechanics.restoring_forces import CollapseError
from structid.models.masonry.equations.static_wall import BeamedWall, StaticWall
from structid.models.masonry.finite_elements.assembly import Assembly, Masonry
from structid.models.masonry.finite_elements.layout import FACADE, Wall
from structid.models.masonry.finite_elements.mesh import mesh_of
from structid.models.masonry.masonry_wall import MasonryWall

pytestmark = pytest.mark.quick
MORTAR = {"normal_energy": 15.0, "normal_strength": 0.2e6, "tangential_energy": 150.0, "tangential_strength": 0.3e6}
PIER = Wall(width=1.2, height=1.2, openings=(), courses=(3,))


def static_wall(layout=FACADE, law="damage-friction", friction=0.65, load=208e3):
    wall = MasonryWall(**MORTAR, joint_law=law, friction=friction, wall=layout, masonry=Masonry(vertical_load=load))
    return wall.static_force(np.zeros((1, 0)))


def along(wall, places):
    """Forces on a way, and what is remembered at its end."""
    memory, forces = wall.at_rest(np.zeros(3)), []
    for place in places:
        force, memory = wall.at(memory, np.asarray(place, dtype=float))
        forces.append(force)
    return np.array(forces), memory


def pushed(amplitudes, step=1e-4):
    """u_x from turn to turn, in steps of a tenth of a millimetre or less."""
    way, last = [], 0.0
    for turn in amplitudes:
        way += list(np.linspace(last, turn, max(int(np.ceil(abs(turn - last) / step - 1e-9)), 1) + 1)[1:])
        last = turn
    return np.column_stack([way, np.zeros(len(way)), np.zeros(len(way))])


def test_it_stands_under_its_load():
    wall = static_wall()
    forces, memory = along(wall, [[0.0, 0.0, 0.0]])
    np.testing.assert_allclose(forces[0], wall.wall.load, rtol=3e-5, atol=1.0)
    np.testing.assert_allclose(wall.force_at_rest(np.zeros(3)), wall.wall.load)
    assert wall.wall.load[1] == pytest.approx(-208e3)
    assert memory["rest"][1, 0] < -1e-4


def test_its_stiffness_is_that_of_condensed_finite_elements():
    wall = static_wall(load=1.0)
    mesh, law = wall.wall.mesh, wall.law
    assembly = Assembly(mesh, Masonry())
    joints = np.stack([law.normal_stiffness * assembly.joint_areas, law.tangential_stiffness * assembly.joint_areas], 1)
    stiffness = assembly.block_stiffness + assembly.jumps.T @ (joints.ravel()[:, None] * assembly.jumps)
    top = wall.wall.top_nodes
    held = [assembly.dof(node, direction) for node in top for direction in (0, 1)]
    shapes = constraint_modes(stiffness, held) @ wall.wall.rigid(top)
    # Without bars, as it is here: the beam is rigid.
    np.testing.assert_allclose(wall.initial_stiffness(), shapes.T @ stiffness @ shapes, rtol=2e-3, atol=2e3)


def test_its_stiffness_is_the_slope_of_its_force():
    wall = static_wall()
    stiffness, rest = wall.initial_stiffness(), along(wall, [[0.0, 0.0, 0.0]])[0][0]
    for k, small in enumerate((1e-7, 1e-7, 1e-7)):
        place = np.zeros(3)
        place[k] = small
        slope = (along(wall, [place])[0][0] - rest) / small
        np.testing.assert_allclose(slope, stiffness[k], rtol=1e-3, atol=5e-3 * np.abs(stiffness).max())


def test_the_way_does_not_depend_on_its_steps_before_cracks_run():
    coarse, fine = (along(static_wall(), pushed([4e-4, -4e-4, 2e-4], step))[0][-1] for step in (1e-4, 2.5e-5))
    np.testing.assert_allclose(coarse, fine, rtol=2e-3, atol=50.0)


def test_a_closed_cycle_takes_energy_and_gives_none():
    way = np.vstack([np.zeros((1, 3)), pushed([6e-3, -6e-3, 6e-3, -6e-3, 0.0])])
    forces, memory = along(static_wall(), way)
    work = np.cumsum(0.5 * (forces[1:, 0] + forces[:-1, 0]) * np.diff(way[:, 0]))
    assert work[-1] > 50.0
    assert (memory["joints"][0] > 1.0).sum() >= 4  # cracks
    ends = np.flatnonzero(np.isclose(way[1:, 0], 6e-3))
    assert work[ends[1]] > work[ends[0]]  # a second cycle takes, too


def test_the_smaller_the_cycle_the_more_of_its_work_comes_back():
    """Without a load joints damage by the cube of a move, and store by its square."""

    def lost(amplitude):
        way = np.vstack([np.zeros((1, 3)), pushed([amplitude, -amplitude, 0.0], amplitude / 10)])
        forces, _ = along(static_wall(load=1.0), way)
        work = 0.5 * ((forces[1:, 0] + forces[:-1, 0]) * np.diff(way[:, 0])).sum()
        return work / (0.5 * np.abs(forces[:, 0]).max() * amplitude)

    large, small = lost(2e-5), lost(5e-6)
    assert 0.0 < small < 0.5 * large < 0.1


def test_a_joint_that_loses_what_lies_on_it_is_a_collapse():
    wall = static_wall(PIER, load=60e3)
    with pytest.raises(CollapseError, match="lost its support"):
        along(wall, pushed([0.8], step=2e-3))


def test_many_runs_inside_jax_are_as_each_alone():
    way = pushed([8e-4, -3e-4], 1e-4)
    alone = along(static_wall(PIER, load=60e3), way)[0]
    beamed = BeamedWall(mesh_of(PIER), Masonry(vertical_load=60e3), JOINT_LAWS["damage-friction"])
    energies = np.array([15.0, 30.0])
    law = cohesive_law(energies, 0.2e6, 150.0, 0.3e6, friction=0.65)

    def forces():
        both = StaticWall(beamed, law, 2)
        nothing = jax.numpy.zeros((3, 2))

        def move(memory, place):
            force, after = both.at(memory, nothing + place[:, None])
            return after, force

        return jax.lax.scan(move, both.at_rest(nothing), way)[1]

    found = np.asarray(jax.jit(forces)())
    np.testing.assert_allclose(found[:, :, 0], alone, rtol=1e-6, atol=1.0)
    assert np.abs(found[:, :, 1] - found[:, :, 0]).max() > 10.0
