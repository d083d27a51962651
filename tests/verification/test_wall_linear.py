"""Walls in the limit in which they are linear: a cantilever by beam theory, small motions by modal superposition."""

import numpy as np
import pytest
import scipy

import structid as si
from structid.mechanics.cohesive_laws import cohesive_law
from structid.models.masonry.finite_elements.assembly import Assembly, Masonry
from structid.models.masonry.finite_elements.layout import FACADE, Wall
from structid.models.masonry.finite_elements.mesh import mesh_of

JOINTS = dict(normal_energy=5.5e3, normal_strength=1.05e6, tangential_energy=4e5, tangential_strength=2e6)


def tip(courses, across=1):
    """Deflection under a force at the top of a pillar 0.25 m wide and 2.5 m high, whose joints do not give, over beam theory's."""
    masonry = Masonry()
    wall = Wall(width=0.25, height=2.5, openings=(), courses=(courses,), block_length=0.25 / across)
    assembly = Assembly(mesh_of(wall, "gauss"), masonry)
    stiff = 1e4 * masonry.modulus * wall.thickness
    stiffness = assembly.sparse_block_stiffness + stiff * assembly.sparse_jumps.T @ assembly.sparse_jumps
    top = [assembly.dof(assembly.mesh.corner(corner), 0) for corner in ("top_left", "top_right")]
    force = np.zeros(stiffness.shape[0])
    force[top] = 0.5
    found = scipy.sparse.linalg.spsolve(stiffness.tocsc(), force)[top].mean()
    second_moment, area = wall.thickness * wall.width**3 / 12.0, wall.thickness * wall.width
    shear = masonry.modulus / (2.0 * (1.0 + masonry.poisson))
    # Timoshenko: P L³/(3 E I) + P L/(κ G A), κ = 10 (1 + ν)/(12 + 11 ν) (Cowper's).
    kappa = 10.0 * (1.0 + masonry.poisson) / (12.0 + 11.0 * masonry.poisson)
    beam = wall.height**3 / (3.0 * masonry.modulus * second_moment) + wall.height / (kappa * shear * area)
    return found / beam


def test_a_cantilever_of_single_blocks_is_too_stiff_by_what_theory_says():
    """A bilinear block of height a and width b bends as if E were E/(1 − ν²) (1 + ½ (1 − ν) a²/b²): R. D. Cook et al. (2002)."""
    courses = np.array([10, 20, 40])
    found = np.array([tip(count) for count in courses])
    of_theory = (1.0 - 0.2**2) / (1.0 + 0.5 * (1.0 - 0.2) * (2.5 / courses / 0.25) ** 2)
    np.testing.assert_allclose(found, of_theory, rtol=0.01)


def test_a_cantilever_of_many_blocks_is_timoshenkos():
    """The error falls with the square of the blocks' size."""
    errors = np.array([1.0 - tip(20 * across, across) for across in (2, 4, 8)])
    assert errors[-1] < 0.01
    assert (errors[:-1] / errors[1:] > 3.0).all()


def by_modes(record):
    """Drift of the unloaded façade by its modes, each integrated exactly along the straight lines of the record."""
    assembly = Assembly(mesh_of(FACADE), Masonry(vertical_load=0.0))
    law = cohesive_law(*JOINTS.values())
    # ∂T/∂Δ at the origin, the same on both sides: σ e/δ_n and τ e/δ_t times the area.
    springs = np.stack(
        [law.normal_stiffness * assembly.joint_areas, law.tangential_stiffness * assembly.joint_areas], 1
    )
    stiffness = assembly.block_stiffness + assembly.jumps.T @ (springs.ravel()[:, None] * assembly.jumps)
    stiffness += assembly.elongations.T @ (assembly.bar_stiffness[:, None] * assembly.elongations)
    squares, shapes = scipy.linalg.eigh(stiffness, assembly.mass)
    omega = np.sqrt(squares)
    damping = np.linalg.solve([[0.5 / omega[0], 0.5 * omega[0]], [0.5 / omega[2], 0.5 * omega[2]]], [0.03, 0.03])
    ratios = 0.5 * (damping[0] / omega + damping[1] * omega)
    pushed = shapes.T @ assembly.mass @ assembly.horizontal
    drift = np.zeros(len(record))
    row = shapes[assembly.dof(assembly.mesh.corner("top_left"), 0)]
    for number, (w, ratio) in enumerate(zip(omega, ratios, strict=True)):
        system = scipy.signal.StateSpace(
            [[0.0, 1.0], [-(w**2), -2.0 * ratio * w]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]
        )
        discrete = scipy.signal.cont2discrete((system.A, system.B, system.C, system.D), record.dt, "foh")
        _, answer, _ = scipy.signal.dlsim(discrete, -pushed[number] * record.values)
        drift += row[number] * answer[:, 0]
    return drift


@pytest.mark.slow
def test_small_motions_are_those_of_modes():
    """At a ten-thousandth of the record joints are linear; what is left is the step's error, of second order."""
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(4.0, 5.5)
    record = si.GroundMotion(record.values - record.values[0], record.dt).scale_to_pga(1e-4)
    expected, errors = by_modes(record), []
    for step in (1e-3, 5e-4):
        wall = si.MasonryWall(**JOINTS, masonry=Masonry(vertical_load=0.0), channels=("drift",), step=step)
        found = wall.simulate([[]], record).values[0, :, 0]
        errors.append(np.linalg.norm(found - expected) / np.linalg.norm(expected))
    assert errors[0] < 2e-3
    assert 3.0 < errors[0] / errors[1] < 5.0
