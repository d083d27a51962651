"""Reduced substructures: statically exact, frequencies from above, and the facade's two storeys."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from structid.core.errors import InputError
from structid.hybrid.coupling.partitioned_run import run_over
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.substructures.facade_parts import FloorMasses, facade_parts
from structid.hybrid.substructures.reduction import reduced_by_craig_bampton, reduced_by_guyan
from structid.hybrid.substructures.substructure import Substructure
from structid.models.masonry.finite_elements.layout import Wall
from structid.models.masonry.masonry_wall import MasonryWall

pytestmark = pytest.mark.quick


def chain(count=8, stiffness=4e6, mass=900.0):
    """A chain whose first end is free; its last one is held by a spring."""
    rows = np.eye(count) - np.eye(count, k=1)
    k = stiffness * rows.T @ rows
    return np.diag(mass * np.linspace(1.0, 1.6, count)), 2e-4 * k, k


def frequencies(part):
    return np.sqrt(scipy.linalg.eigh(part.stiffness, part.mass, eigvals_only=True))


def test_guyan_is_statically_exact_and_too_stiff_in_motion():
    mass, damping, stiffness = chain()
    part = reduced_by_guyan(mass, damping, stiffness, kept=[0, 3, 6], interface=[0])
    load = np.zeros(8)
    load[[0, 3, 6]] = [1e3, -2e3, 5e2]
    np.testing.assert_allclose(
        np.linalg.solve(part.stiffness, load[[0, 3, 6]]), np.linalg.solve(stiffness, load)[[0, 3, 6]], rtol=1e-12
    )
    whole = np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True))[:3]
    assert (frequencies(part) >= whole * (1.0 - 1e-12)).all()
    assert frequencies(part)[0] == pytest.approx(whole[0], rel=2e-2)


def test_massless_degrees_of_freedom_are_condensed_without_loss():
    mass, damping, stiffness = chain()
    mass[[1, 2, 4, 5, 7]] = 0.0
    part = reduced_by_guyan(mass, damping, stiffness, kept=[0, 3, 6], interface=[0, 6])
    compliance = np.linalg.inv(stiffness)[np.ix_([0, 3, 6], [0, 3, 6])]
    np.testing.assert_allclose(np.linalg.inv(part.stiffness), compliance, rtol=1e-12)
    assert part.interface.tolist() == [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize("modes", [0, 1, 3, 7])
def test_craig_bampton_comes_down_to_the_whole_with_more_modes(modes):
    mass, damping, stiffness = chain()
    part = reduced_by_craig_bampton(mass, damping, stiffness, [0], modes)
    whole = np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True))
    found = frequencies(part)
    assert (found >= whole[: len(found)] * (1.0 - 1e-12)).all()
    if modes == 7:
        np.testing.assert_allclose(found, whole, rtol=1e-10)
    else:
        finer = reduced_by_craig_bampton(mass, damping, stiffness, [0], modes + 1)
        assert (frequencies(finer)[: len(found)] <= found * (1.0 + 1e-12)).all()
    assert part.base_load.sum() != 0.0


def test_a_coupled_run_with_all_modes_is_that_of_the_whole_part():
    mass, damping, stiffness = chain(5)
    other = Substructure([[700.0]], [[3e3]], [[5e6]], [0])
    base = 3.0 * np.sin(np.arange(201) * 0.05)
    runs = []
    for part in (
        Substructure(mass, damping, stiffness, [0]),
        reduced_by_craig_bampton(mass, damping, stiffness, [0], 4),
    ):
        joined = PrakashHjelmstad(4, "numerical").joined(part, other, 0.02)
        runs.append(run_over(joined, np.repeat(base, 4)[: 200 * 4 + 1]))
    np.testing.assert_allclose(
        runs[1].coarse.physical.displacement, runs[0].coarse.physical.displacement, rtol=1e-8, atol=1e-12
    )
    np.testing.assert_allclose(runs[1].coarse.traction, runs[0].coarse.traction, rtol=1e-7, atol=1e-3)


def test_bad_reductions_are_refused():
    mass, damping, stiffness = chain()
    with pytest.raises(InputError, match="kept degrees of freedom only"):
        reduced_by_guyan(mass, damping, stiffness, kept=[0, 3], interface=[1])
    with pytest.raises(InputError, match="each once"):
        reduced_by_guyan(mass, damping, stiffness, kept=[0, 0], interface=[0])
    with pytest.raises(InputError, match="from 0 to 7"):
        reduced_by_craig_bampton(mass, damping, stiffness, [0], 8)
    loose = stiffness.copy()
    loose[5], loose[:, 5] = 0.0, 0.0
    with pytest.raises(InputError, match="without force"):
        reduced_by_guyan(mass, damping, loose, kept=[0], interface=[0])
    with pytest.raises(InputError, match="the same size"):
        reduced_by_guyan(mass, damping[:3, :3], stiffness, kept=[0], interface=[0])


# --- the facade -----------------------------------------------------------------------------------------------------


def typical_wall(**settings):
    joints = {
        "normal_energy": 15.0,
        "normal_strength": 0.2e6,
        "tangential_energy": 150.0,
        "tangential_strength": 0.3e6,
        "joint_law": "damage-friction",
        "friction": 0.65,
    }
    return MasonryWall(**joints | settings)


@pytest.fixture(scope="module")
def facade():
    return facade_parts(typical_wall())


def test_the_upper_storey_has_four_or_seven_degrees_of_freedom(facade):
    assert facade.upper.dofs == 4 and facade.lower.dofs == 3
    seven = facade_parts(typical_wall(), modes=4).upper
    assert seven.dofs == 7
    np.testing.assert_allclose(seven.stiffness[:3, :3], facade.upper.stiffness[:3, :3], rtol=1e-9)
    np.testing.assert_allclose(seven.mass[:4, :4], facade.upper.mass, rtol=1e-9, atol=1e-6)


def test_a_beam_that_moves_as_a_rigid_body_strains_nothing_and_carries_the_mass(facade):
    upper, masses = facade.upper, FloorMasses()
    wall = (2.7 * 2.6 - 0.9 * 1.6) * 0.15 * 1000.0
    above = masses.roof + (1.0 - masses.share) * masses.floor + wall
    # Modes above a beam at rest take no part in it.
    assert np.abs(upper.stiffness[:3, :3]).max() < 1e-6 * upper.stiffness[3, 3] * above
    for direction in (0, 1):
        assert upper.mass[direction, direction] == pytest.approx(above, rel=1e-9)
    np.testing.assert_allclose(upper.influence, [1.0, 0.0, 0.0, 0.0], atol=1e-9)


def test_its_frequencies_come_down_with_more_modes(facade):
    def whole(modes):
        upper = facade_parts(typical_wall(), modes=modes).upper
        mass, stiffness = upper.mass.copy(), upper.stiffness.copy()
        mass[:3, :3] += facade.lower.mass
        stiffness[:3, :3] += facade.lower.stiffness
        return np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True))[:3]

    one, four, ten = whole(1), whole(4), whole(10)
    assert (four <= one * (1.0 + 1e-9)).all() and (ten <= four * (1.0 + 1e-9)).all()
    assert four[0] == pytest.approx(ten[0], rel=2e-3)


def test_walls_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="free"):
        facade_parts(replace(typical_wall(), normal_energy=None, free=("normal_energy",)))
    with pytest.raises(InputError, match="without joints"):
        facade_parts(typical_wall(), typical_wall(base_joint=True))
    with pytest.raises(InputError, match=r"2\.7 m wide"):
        facade_parts(typical_wall(), typical_wall(wall=Wall(width=3.0, height=2.6, openings=(), courses=(2,))))
