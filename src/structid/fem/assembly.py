"""Matrices of a wall: mass, stiffness of its blocks, jumps of its joints and elongations of its bars, loads.

Forces of joints and bars are formed from their jumps and elongations. Formed as K u, the short bars of 10¹¹ N/m would leave a
rounding error in the residual that no iteration removes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from structid.errors import InputError, names_checked
from structid.fem.elements import block_mass, block_stiffness
from structid.fem.mesh import SHORT_BAR, Mesh


@names_checked
@dataclass(frozen=True)
class Masonry:
    """What blocks, beam and loads are made of.

    Parameters
    ----------
    modulus, poisson, density : float
        E [Pa], ν and density [kg/m³] of the blocks. They have no weight.
    steel_modulus, steel_area : float
        E [Pa] and area [m²] of the loading beam.
    vertical_load : float
        On the bays that reach the base, shared by their area [N].
    upper_mass : float
        Of the storey above, on the beam [kg].
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
                raise InputError(f"Masonry.{name}", f"{getattr(self, name):g}", "0 or more")
        if not -1.0 < self.poisson < 0.5:
            raise InputError("Masonry.poisson", f"{self.poisson:g}", "a number between -1 and 0.5")


@dataclass(frozen=True, eq=False)
class Assembly:
    """Matrices over the free degrees of freedom.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    masonry : Masonry
        Materials and loads.
    """

    mesh: Mesh = field(repr=False)
    masonry: Masonry

    @cached_property
    def mass(self) -> np.ndarray:
        """M, shape (dof, dof) [kg]."""
        full = np.zeros((2 * len(self.mesh.nodes),) * 2)
        for nodes, dofs in zip(self.mesh.blocks, self._block_dofs, strict=True):
            own = block_mass(self.mesh.nodes[nodes], self.mesh.wall.thickness, self.masonry.density)
            full[np.ix_(dofs, dofs)] += own
        for node, share in self.beam_shares(everywhere=True):
            for dof in (2 * node, 2 * node + 1):
                full[dof, dof] += self.masonry.upper_mass * share
        return self._freed(full)

    @cached_property
    def block_stiffness(self) -> np.ndarray:
        """Stiffness of the blocks alone, shape (dof, dof) [N/m]."""
        full, m = np.zeros((2 * len(self.mesh.nodes),) * 2), self.masonry
        for nodes, dofs in zip(self.mesh.blocks, self._block_dofs, strict=True):
            corners = self.mesh.nodes[nodes]
            full[np.ix_(dofs, dofs)] += block_stiffness(corners, self.mesh.wall.thickness, m.modulus, m.poisson)
        return self._freed(full)

    @cached_property
    def jumps(self) -> np.ndarray:
        """Rows that give opening and slip of every joint, (Δ_n, Δ_t) one after the other, shape (2 joint, dof)."""
        full = np.zeros((2 * len(self.mesh.joints), 2 * len(self.mesh.nodes)))
        for number, joint in enumerate(self.mesh.joints):
            n_x, n_y = joint.normal
            # The tangent is horizontal where the normal is vertical, and vertical where it is horizontal.
            directions = ((n_x, n_y), (n_y, n_x))
            for row, direction in zip((2 * number, 2 * number + 1), directions, strict=True):
                for nodes, sign in ((joint.upper, 1.0), (joint.lower, -1.0)):
                    for node, weight in zip(nodes, joint.weights, strict=True):
                        if node >= 0:
                            full[row, 2 * node : 2 * node + 2] += sign * weight * np.array(direction)
        return np.asarray(full[:, self.mesh.free])

    @cached_property
    def joint_areas(self) -> np.ndarray:
        """Of every joint, shape (joint,) [m²]."""
        return np.array([joint.area for joint in self.mesh.joints])

    @cached_property
    def elongations(self) -> np.ndarray:
        """Rows that give the elongation of every bar, shape (bar, dof). All bars are horizontal."""
        full = np.zeros((len(self.mesh.bars), 2 * len(self.mesh.nodes)))
        for row, (one, other) in enumerate(self.mesh.bars):
            full[row, 2 * one], full[row, 2 * other] = -1.0, 1.0
        return np.asarray(full[:, self.mesh.free])

    @cached_property
    def bar_stiffness(self) -> np.ndarray:
        """E A / L of every bar, shape (bar,) [N/m]."""
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
        """ι of a horizontal motion of the base: one for every horizontal degree of freedom, shape (dof,)."""
        return np.asarray((self.mesh.free % 2 == 0).astype(np.float64))

    @cached_property
    def short_bars(self) -> np.ndarray:
        """Which bars join two blocks, shape (bar,)."""
        return np.asarray(self.mesh.bar_lengths == SHORT_BAR)

    def dof(self, node: int, direction: int) -> int:
        """Place of a degree of freedom among the free ones.

        Parameters
        ----------
        node : int
            Of the mesh.
        direction : int
            0 is horizontal, 1 vertical.

        Returns
        -------
        int
            Its place.
        """
        return int(np.searchsorted(self.mesh.free, 2 * node + direction))

    @property
    def _block_dofs(self) -> np.ndarray:
        return np.stack([2 * self.mesh.blocks, 2 * self.mesh.blocks + 1], axis=-1).reshape(len(self.mesh.blocks), 8)

    def beam_shares(self, everywhere: bool) -> list[tuple[int, float]]:
        """Nodes of the beam with their shares by tributary length, half of a block's to each end.

        Parameters
        ----------
        everywhere : bool
            Of all blocks under the beam, or of those above bays that reach the base.

        Returns
        -------
        list of tuple of int and float
            Node and share; the shares add up to one.
        """
        mesh, found = self.mesh, []
        standing = [(mesh.nodes[b[0], 0], mesh.nodes[b[1], 0]) for b in mesh.blocks if mesh.nodes[b[0], 1] == 0.0]
        for block in mesh.top_blocks:
            nodes = mesh.blocks[block]
            left, right = mesh.nodes[nodes[0], 0], mesh.nodes[nodes[1], 0]
            middle = 0.5 * (left + right)
            if everywhere or any(low < middle < high for low, high in standing):
                found += [(int(nodes[3]), 0.5 * (right - left)), (int(nodes[2]), 0.5 * (right - left))]
        total = sum(share for _, share in found)
        return [(node, share / total) for node, share in found]

    def _freed(self, full: np.ndarray) -> np.ndarray:
        return np.asarray(full[np.ix_(self.mesh.free, self.mesh.free)])
