"""Equations of motion of a wall, condensed to the jumps of its joints, for many runs at once inside JAX.

Blocks are linear, and only joints and short bars connect them. In the mass-orthonormal modes q of the separate blocks, the linear
part is diagonal for any joint law. With average acceleration, u′ = 2/Δt (u − u₀) − u₀′ and u″ = 4/Δt² (u − u₀) − 4/Δt u₀′ − u₀″,
the equations of a step are

    q = W (b − Vᵀ g(δ)),    W = 1 / (4/Δt² + 2 a₀/Δt + (1 + 2 a₁/Δt) λ),    δ = V q,
    b = p − ι a_g + 4/Δt² q₀ + 4/Δt q₀′ + q₀″ + (a₀ + a₁ λ)(2/Δt q₀ + q₀′),
    g(δ) = f(δ) + a₁ D₀ δ′,    δ′ = 2/Δt (δ − δ₀) − δ₀′,

with the forces f of joints and short bars, and their symmetric tangent D₀ at the loaded wall. The only unknowns are therefore the
jumps: δ = V W b − F g(δ), F = V W Vᵀ. The Newton matrix is I + F (D + 2 a₁/Δt D₀).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.engine.matrices.block_sparse import BlockPattern, SparseMatrix
from structid.mechanics.cohesive_laws import CohesiveLaw, JointLaw
from structid.models.masonry.finite_elements.assembly import Assembly


@dataclass(frozen=True, eq=False)
class Condensed:
    """Constants of the condensed equations."""

    assembly: Assembly = field(repr=False)  # matrices of the wall
    joint_law: JointLaw  # law of all joints

    @cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Mass-orthonormal modes of every block with its inner bars: Φ, shape (dof, mode), and λ."""
        a = self.assembly
        inside = ~a.short_bars
        stiffness = a.block_stiffness + a.elongations[inside].T @ (
            a.bar_stiffness[inside, None] * a.elongations[inside]
        )
        block_of_dof = a.mesh.free // 8
        shapes, squares = np.zeros_like(stiffness), np.zeros(len(stiffness))
        for block in range(len(a.mesh.blocks)):
            block_dofs = np.flatnonzero(block_of_dof == block)
            here = np.ix_(block_dofs, block_dofs)
            values, vectors = scipy.linalg.eigh(stiffness[here], a.mass[here])
            # Rigid-body modes have λ = 0, up to rounding.
            squares[block_dofs], shapes[here] = np.where(values > 1e-9 * values.max(), values, 0.0), vectors
        return shapes, squares

    @property
    def shapes(self) -> np.ndarray:
        """Mode shapes Φ, shape (dof, mode): u = Φ q."""
        return self._modes[0]

    @property
    def squares(self) -> np.ndarray:
        """Squared frequencies λ, shape (mode,) [1/s²]."""
        return self._modes[1]

    @cached_property
    def jump_rows(self) -> np.ndarray:
        """Matrix V, shape (jump, mode): opening and slip of every joint in turn, then elongations of the short bars.

        Elongations are grouped in pairs, like the jumps of a joint; a row of zeros completes the last pair if
        necessary.
        """
        a = self.assembly
        rows = np.concatenate([a.jumps, a.elongations[a.short_bars]]) @ self.shapes
        rows = np.concatenate([rows, np.zeros((len(rows) % 2, rows.shape[1]))])
        return np.where(np.abs(rows) > 1e-12 * np.abs(rows).max(), rows, 0.0)

    @cached_property
    def opening(self) -> SparseMatrix:
        """V."""
        return SparseMatrix(self.jump_rows)

    @cached_property
    def pushing(self) -> SparseMatrix:
        """Vᵀ."""
        return SparseMatrix(np.ascontiguousarray(self.jump_rows.T))

    @cached_property
    def pattern(self) -> BlockPattern:
        """Sparsity pattern of F: two pairs of jumps are coupled if they share a block."""
        touching = np.abs(self.jump_rows).reshape(len(self.jump_rows) // 2, 2, -1).max(axis=1) > 0.0
        return BlockPattern.of((touching.astype(int) @ touching.T.astype(int)) > 0)

    @cached_property
    def load(self) -> np.ndarray:
        """Modal load Φᵀ p, shape (mode,)."""
        return np.asarray(self.shapes.T @ self.assembly.load)

    @cached_property
    def inertia(self) -> np.ndarray:
        """Modal inertia Φᵀ M ι, shape (mode,)."""
        return np.asarray(self.shapes.T @ self.assembly.mass @ self.assembly.horizontal)

    @cached_property
    def bars(self) -> np.ndarray:
        """Stiffness E A / L of the short bars, shape (bar,) [N/m]; zero for the row that completes a pair."""
        bars = self.assembly.bar_stiffness[self.assembly.short_bars]
        return np.concatenate([bars, np.zeros(len(bars) % 2)])

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.assembly.joint_areas)

    # --- forces -------------------------------------------------------------------------------------------------

    def forces(
        self, law: CohesiveLaw, memory: Float[Array, "memory joint run"], jumps: Float[Array, "jump run"]
    ) -> tuple[Any, Any]:
        """Compute the forces of joints and short bars, and their tangent."""
        areas, count = self.assembly.joint_areas[:, None], 2 * self.joints
        response = self.joint_law.respond(law, memory, jumps[0:count:2], jumps[1:count:2])
        of_joints = jnp.stack([response.normal * areas, response.tangential * areas], axis=1).reshape(count, -1)
        rows = [
            jnp.stack([a * areas, b * areas], axis=1)
            for a, b in ((response.nn, response.nt), (response.tn, response.tt))
        ]
        of_bars = jnp.broadcast_to(self._bar_blocks, (len(self.bars) // 2, 2, 2, jumps.shape[1]))
        tangent = jnp.concatenate([jnp.stack(rows, axis=1), of_bars])
        return jnp.concatenate([of_joints, self.bars[:, None] * jumps[count:]]), tangent

    @property
    def _bar_blocks(self) -> np.ndarray:
        """Stiffness blocks of the bars, shape (pair, 2, 2, 1)."""
        return (self.bars.reshape(-1, 2, 1) * np.eye(2))[..., None]

    def remembered(
        self, law: CohesiveLaw, memory: Float[Array, "memory joint run"], jumps: Float[Array, "jump run"]
    ) -> Float[Array, "memory joint run"]:
        """Return the memory of the joints after a step."""
        count = 2 * self.joints
        return self.joint_law.remembered(law, memory, jumps[0:count:2], jumps[1:count:2])

    def compliance(self, weights: Float[Array, "mode run"]) -> Float[Array, "block 2 2 run"]:
        """Compute the blocks of F = V W Vᵀ."""
        rows, pattern = self.jump_rows.reshape(-1, 2, len(self.squares)), self.pattern
        return jnp.einsum("bim,mr,bjm->bijr", rows[pattern.rows], weights, rows[pattern.columns])
