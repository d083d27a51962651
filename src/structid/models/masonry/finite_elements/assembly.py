"""Matrices of a wall: mass, stiffness of its blocks, jumps of its joints, elongations of its bars, loads.

Forces of joints and bars are computed from jumps and elongations. In a product K u, the short bars of 10¹¹ N/m would
leave a rounding error in the residual that iterations cannot remove.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.models.masonry.finite_elements.elements import block_mass, block_stiffness
from structid.models.masonry.finite_elements.mesh import SHORT_BAR, Mesh


@check_arguments
@dataclass(frozen=True)
class Masonry:
    """Materials of blocks and beam, and loads.

    Parameters
    ----------
    modulus, poisson, density : float
        E [Pa], ν and density [kg/m³] of the blocks. The blocks have no weight.
    steel_modulus, steel_area : float
        E [Pa] and area [m²] of the loading beam.
    vertical_load : float
        Load on the bays that reach the base, divided in proportion to their areas [N].
    upper_mass : float
        Mass of the storey above, on the beam [kg].

    Examples
    --------
    >>> import structid as si
    >>> masonry = si.Masonry(modulus=4.2e9, density=1800.0)
    >>> masonry.poisson
    0.2
    """

    modulus: float = 4.21e9
    poisson: float = 0.2
    density: float = 1000.0
    steel_modulus: float = 210e9
    steel_area: float = 0.01
    vertical_load: float = 208e3
    upper_mass: float = 12_000.0

    def __post_init__(self) -> None:
        for name in ("modulus", "density", "steel_modulus", "steel_area"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"Masonry.{name}", f"{getattr(self, name):g}", "a positive number")
        for name in ("vertical_load", "upper_mass"):
            if not getattr(self, name) >= 0.0:
                raise InputError(f"Masonry.{name}", f"{getattr(self, name):g}", "a number of 0 or more")
        if not -1.0 < self.poisson < 0.5:
            raise InputError("Masonry.poisson", f"{self.poisson:g}", "a number between -1 and 0.5")


@dataclass(frozen=True, eq=False)
class Assembly:
    """Matrices of a wall for its free degrees of freedom."""

    mesh: Mesh = field(repr=False)
    masonry: Masonry  # Materials and loads

    @cached_property
    def sparse_mass(self) -> scipy.sparse.csr_array:
        """Mass matrix M, shape (dof, dof) [kg]."""
        beam = np.zeros(2 * len(self.mesh.nodes))
        for node, share in self.beam_shares(everywhere=True):
            beam[2 * node : 2 * node + 2] += self.masonry.upper_mass * share
        thickness, density = self.mesh.wall.thickness, self.masonry.density
        blocks = self._of_blocks(lambda corners: block_mass(corners, thickness, density))
        return self._freed(blocks + scipy.sparse.diags_array(beam))

    @cached_property
    def mass(self) -> np.ndarray:
        """Mass matrix M as a dense array, shape (dof, dof) [kg]."""
        return np.asarray(self.sparse_mass.toarray())

    @cached_property
    def sparse_block_stiffness(self) -> scipy.sparse.csr_array:
        """Stiffness of the blocks only, shape (dof, dof) [N/m]."""
        thickness, m = self.mesh.wall.thickness, self.masonry
        return self._freed(self._of_blocks(lambda corners: block_stiffness(corners, thickness, m.modulus, m.poisson)))

    @cached_property
    def block_stiffness(self) -> np.ndarray:
        """Stiffness of the blocks as a dense array, shape (dof, dof) [N/m]."""
        return np.asarray(self.sparse_block_stiffness.toarray())

    @cached_property
    def sparse_jumps(self) -> scipy.sparse.csr_array:
        """Matrix that gives the opening and slip (Δ_n, Δ_t) of each joint in turn, shape (2 joint, dof)."""
        rows, columns, values = [], [], []
        for number, joint in enumerate(self.mesh.joints):
            n_x, n_y = joint.normal
            # A vertical normal has a horizontal tangent, and a horizontal normal a vertical tangent.
            for row, direction in ((2 * number, (n_x, n_y)), (2 * number + 1, (n_y, n_x))):
                for nodes, sign in ((joint.upper, 1.0), (joint.lower, -1.0)):
                    for node, weight in zip(nodes, joint.weights, strict=True):
                        if node >= 0 and weight != 0.0:
                            rows += [row, row]
                            columns += [2 * node, 2 * node + 1]
                            values += [sign * weight * direction[0], sign * weight * direction[1]]
        return self._columns(rows, columns, values, 2 * len(self.mesh.joints))

    @cached_property
    def jumps(self) -> np.ndarray:
        """Matrix of the jumps as a dense array, shape (2 joint, dof)."""
        return np.asarray(self.sparse_jumps.toarray())

    @cached_property
    def joint_areas(self) -> np.ndarray:
        """Area of every joint, shape (joint,) [m²]."""
        return np.array([joint.area for joint in self.mesh.joints])

    @cached_property
    def sparse_elongations(self) -> scipy.sparse.csr_array:
        """Matrix that gives the elongation of every bar, shape (bar, dof). All bars are horizontal."""
        rows = np.repeat(np.arange(len(self.mesh.bars)), 2)
        return self._columns(
            rows, 2 * self.mesh.bars.ravel(), np.tile([-1.0, 1.0], len(self.mesh.bars)), len(self.mesh.bars)
        )

    @cached_property
    def elongations(self) -> np.ndarray:
        """Matrix of the elongations as a dense array, shape (bar, dof)."""
        return np.asarray(self.sparse_elongations.toarray())

    @cached_property
    def bar_stiffness(self) -> np.ndarray:
        """Stiffness E A / L of every bar, shape (bar,) [N/m]."""
        return np.asarray(self.masonry.steel_modulus * self.masonry.steel_area / self.mesh.bar_lengths)

    @cached_property
    def load(self) -> np.ndarray:
        """Vertical load on the beam, shape (dof,) [N]."""
        full = np.zeros(2 * len(self.mesh.nodes))
        for node, share in self.beam_shares(everywhere=False):
            full[2 * node + 1] -= self.masonry.vertical_load * share
        return np.asarray(full[self.mesh.free])

    @cached_property
    def horizontal(self) -> np.ndarray:
        """Influence vector ι of horizontal base motion, shape (dof,): 1 for horizontal degrees of freedom, else 0."""
        return np.asarray((self.mesh.free % 2 == 0).astype(np.float64))

    @cached_property
    def short_bars(self) -> np.ndarray:
        """Mask of the bars that connect two blocks, shape (bar,)."""
        return np.asarray(self.mesh.bar_lengths == SHORT_BAR)

    def dof(self, node: int, direction: int) -> int:
        """Return the index of a degree of freedom among the free degrees of freedom."""
        return int(np.searchsorted(self.mesh.free, 2 * node + direction))

    def beam_shares(self, everywhere: bool) -> list[tuple[int, float]]:
        """Return the nodes of the beam with their tributary fractions; each end of a block gets half of the block's."""
        mesh, shares = self.mesh, []
        standing = [(mesh.nodes[b[0], 0], mesh.nodes[b[1], 0]) for b in mesh.blocks if mesh.nodes[b[0], 1] == 0.0]
        for block in mesh.top_blocks:
            nodes = mesh.blocks[block]
            left, right = mesh.nodes[nodes[0], 0], mesh.nodes[nodes[1], 0]
            middle = 0.5 * (left + right)
            if everywhere or any(low < middle < high for low, high in standing):
                shares += [(int(nodes[3]), 0.5 * (right - left)), (int(nodes[2]), 0.5 * (right - left))]
        total = sum(share for _, share in shares)
        return [(node, share / total) for node, share in shares]

    def _of_blocks(self, of_one: Callable[[np.ndarray], np.ndarray]) -> scipy.sparse.csr_array:
        """Assemble a matrix over all degrees of freedom from the matrices of the blocks."""
        dofs = np.stack([2 * self.mesh.blocks, 2 * self.mesh.blocks + 1], axis=-1).reshape(len(self.mesh.blocks), 8)
        values = np.array([of_one(self.mesh.nodes[nodes]) for nodes in self.mesh.blocks])
        places = np.repeat(dofs, 8, axis=1).ravel(), np.tile(dofs, (1, 8)).ravel()
        size = 2 * len(self.mesh.nodes)
        return scipy.sparse.csr_array((values.ravel(), places), shape=(size, size))

    def _columns(self, rows: Any, columns: Any, values: Any, count: int) -> scipy.sparse.csr_array:
        """Return a sparse matrix, restricted to the free degrees of freedom."""
        full = scipy.sparse.csr_array((values, (rows, columns)), shape=(count, 2 * len(self.mesh.nodes)))
        return scipy.sparse.csr_array(full[:, self.mesh.free])

    def _freed(self, full: Any) -> scipy.sparse.csr_array:
        return scipy.sparse.csr_array(scipy.sparse.csr_array(full)[self.mesh.free][:, self.mesh.free])
