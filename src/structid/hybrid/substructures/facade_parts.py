"""A facade of two storeys: the upper one numerical, the lower one physical, with a rigid beam between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.hybrid.substructures.reduction import constraint_modes, reduced_by_craig_bampton
from structid.hybrid.substructures.substructure import Substructure, proportional_damping
from structid.mechanics.carried_over import CarriedOver
from structid.mechanics.cohesive_laws import CohesiveLaw
from structid.models.masonry.equations.static_wall import BEAM, StaticWall
from structid.models.masonry.finite_elements.assembly import Assembly
from structid.models.masonry.masonry_wall import MasonryWall


@check_arguments
@dataclass(frozen=True)
class FloorMasses:
    """Masses of a facade in addition to the masses of its walls.

    Parameters
    ----------
    floor, roof : float
        Mass on the beam between the storeys, and mass on top [kg].
    share : float
        Fraction of the floor's mass that belongs to the lower storey.

    Examples
    --------
    >>> import structid as si
    >>> masses = si.FloorMasses(floor=8000.0, roof=5000.0)
    >>> masses.share
    0.5
    """

    floor: float = 6000.0
    roof: float = 6000.0
    share: float = 0.5

    def __post_init__(self) -> None:
        if not (self.floor > 0.0 and self.roof >= 0.0 and 0.0 < self.share < 1.0):
            raise InputError("FloorMasses", f"{self}", "floor > 0, roof ≥ 0 and 0 < share < 1")


class FacadeParts(NamedTuple):
    """Parts of a facade that is cut at its beam.

    Parameters
    ----------
    upper, lower : Substructure
        Numerical and physical part. The force of the lower part excludes the force of the vertical load.
    wall : StaticWall
        Lower wall with its vertical load, for a simulated specimen.
    """

    upper: Substructure
    lower: Substructure
    wall: StaticWall


@check_arguments
def facade_parts(
    lower: MasonryWall,
    upper: MasonryWall | None = None,
    *,
    modes: int = 1,
    masses: FloorMasses | None = None,
) -> FacadeParts:
    """Cut a facade at the beam between its storeys.

    The upper storey is linear, with uncracked joints. It is reduced to the beam's three degrees of freedom and its
    lowest modes on a fixed beam (Craig & Bampton 1968). The beam's degrees of freedom are u_x, u_y, and the rotation
    about its middle. Damping is Rayleigh damping with the lower wall's ratio at modes 1 and 3 of both storeys.

    Parameters
    ----------
    lower : MasonryWall
        Lower wall, without free parameters.
    upper : MasonryWall, optional
        Upper wall of the same width; default: the same wall.
    modes : int
        Number of modes of the upper storey: 1 mode gives it 4 degrees of freedom, 4 modes give it 7.
    masses : FloorMasses, optional
        Masses of floor and roof.

    Returns
    -------
    FacadeParts
        The upper part, with the beam's degrees of freedom first; the lower part, with only these; and the lower wall.

    Raises
    ------
    InputError
        If parameters are free, the walls differ in width, or the upper wall has joints at its base.

    Examples
    --------
    >>> import structid as si
    >>> wall = si.MasonryWall(
    ...     normal_energy=15.0, normal_strength=0.2e6, tangential_energy=150.0, tangential_strength=0.3e6,
    ...     joint_law="damage-friction", friction=0.65,
    ... )
    >>> parts = si.facade_parts(wall)
    >>> print(parts.upper.dofs, parts.lower.dofs)
    4 3
    """
    upper, masses = upper or lower, masses or FloorMasses()
    for wall in (lower, upper):
        if wall.free:
            raise InputError(
                "facade_parts", f"a wall with free {', '.join(wall.free)}", "walls without free parameters"
            )
    if upper.wall.width != lower.wall.width or upper.base_joint:
        raise InputError(
            "facade_parts: upper",
            f"a wall {upper.wall.width:g} m wide, base_joint={upper.base_joint}",
            f"a wall {lower.wall.width:g} m wide that stands on the beam without joints",
        )
    inertia = np.array([1.0, 1.0, lower.wall.width**2 / 12.0])  # of a unit mass that is spread along the beam
    force = lower.static_force(np.zeros((1, 0)))
    law = force.law if upper is lower else upper.static_force(np.zeros((1, 0))).law
    above = _matrices_on_beam(upper, law, masses.roof)
    above[0][:BEAM, :BEAM] += np.diag((1.0 - masses.share) * masses.floor * inertia)
    below_mass = _mass_on_beam(force) + np.diag(masses.share * masses.floor * inertia)
    below_stiffness = force.initial_stiffness()
    nothing = np.zeros_like(above[0])
    undamped = reduced_by_craig_bampton(above[0], nothing, above[1], range(BEAM), modes, influence=above[2])
    omega = _whole_frequencies(undamped, below_mass, below_stiffness)
    chosen = [omega[0], omega[min(2, len(omega) - 1)]]
    ratio = lower.damping_ratio
    numerical = replace(
        undamped,
        damping=proportional_damping(undamped.mass, undamped.stiffness, chosen, ratio),
        name="upper storey",
    )
    physical = Substructure(
        below_mass,
        proportional_damping(below_mass, below_stiffness, chosen, ratio),
        below_stiffness,
        list(range(BEAM)),
        CarriedOver(force, np.zeros((1, BEAM))),
        influence=np.array([1.0, 0.0, 0.0]),
        name="lower storey",
    )
    return FacadeParts(numerical, physical, force)


def _whole_frequencies(upper: Substructure, mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return the natural frequencies of both storeys together, uncracked [rad/s]."""
    both = [upper.mass.copy(), upper.stiffness.copy()]
    for whole, part in zip(both, (mass, stiffness), strict=True):
        whole[:BEAM, :BEAM] += part
    return np.asarray(np.sqrt(scipy.linalg.eigh(both[1], both[0], eigvals_only=True)))


def _matrices_on_beam(upper: MasonryWall, law: CohesiveLaw, roof: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return M, K and ι of a wall on a rigid beam, with uncracked joints; the beam's degrees of freedom come first."""
    standing = upper.mesh.fixed
    mesh = replace(upper.mesh, fixed=standing[:0])
    assembly = Assembly(mesh, replace(upper.masonry, upper_mass=roof))
    stiffness = _uncracked(assembly, law) + assembly.elongations.T @ (
        assembly.bar_stiffness[:, None] * assembly.elongations
    )
    carried = np.sort(np.concatenate([2 * standing, 2 * standing + 1]))
    others = np.setdiff1d(mesh.free, carried)
    basis = np.zeros((len(mesh.free), BEAM + len(others)))
    x = mesh.nodes[standing, 0] - 0.5 * mesh.wall.width
    basis[2 * standing, 0], basis[2 * standing + 1, 1], basis[2 * standing + 1, 2] = 1.0, 1.0, x
    basis[others, BEAM + np.arange(len(others))] = 1.0
    influence = np.concatenate([[1.0, 0.0, 0.0], assembly.horizontal[others]])
    return basis.T @ assembly.mass @ basis, basis.T @ stiffness @ basis, influence


def _uncracked(assembly: Assembly, law: CohesiveLaw) -> np.ndarray:
    """Return the stiffness of blocks and uncracked joints, without bars, shape (dof, dof) [N/m]."""
    joints = np.stack([law.normal_stiffness * assembly.joint_areas, law.tangential_stiffness * assembly.joint_areas], 1)
    return np.asarray(assembly.block_stiffness + assembly.jumps.T @ (joints.ravel()[:, None] * assembly.jumps))


def _mass_on_beam(wall: StaticWall) -> np.ndarray:
    """Return the mass matrix of the lower wall's blocks, statically condensed to the beam with uncracked joints."""
    beamed = wall.wall
    assembly = Assembly(beamed.mesh, replace(beamed.masonry, upper_mass=0.0))
    top = beamed.top_nodes
    carried = [assembly.dof(node, direction) for node in top for direction in (0, 1)]
    shapes = constraint_modes(_uncracked(assembly, wall.law), carried) @ beamed.rigid(top)
    return np.asarray(shapes.T @ assembly.mass @ shapes)
