"""Equations of motion of a wall with sparse matrices, one run at a time, for walls too large for compiled vector code."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from structid.models.masonry.equations.dense_newton import DenseWall, WallMatrices

MODES = 6
"""Number of natural frequencies that are computed."""


@dataclass(frozen=True, eq=False)
class SparseWall(DenseWall):
    """A wall with sparse matrices; see `DenseWall`."""

    @cached_property
    def matrices(self) -> WallMatrices:
        """Sparse matrices of the assembly; see `DenseWall.matrices`."""
        a = self.assembly
        bars = a.sparse_elongations
        linear = a.sparse_block_stiffness + bars.T @ scipy.sparse.diags_array(a.bar_stiffness) @ bars
        return WallMatrices(a.sparse_mass, a.sparse_block_stiffness, a.sparse_jumps, bars, linear)

    def block_diagonal(self, blocks: Float[np.ndarray, "joint 2 2"]) -> Any:
        """Assemble a block-diagonal matrix; see `DenseWall.block_diagonal`."""
        count = len(blocks)
        return scipy.sparse.bsr_array(
            (blocks, np.arange(count), np.arange(count + 1)), shape=(2 * count, 2 * count)
        ).tocsr()

    def solved(self, matrix: Any, right: Float[np.ndarray, " dof"]) -> Float[np.ndarray, " dof"]:
        """Solve a linear system by SuperLU; see `DenseWall.solved`."""
        factors = scipy.sparse.linalg.splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return np.asarray(factors.solve(right))

    def lowest(self, stiffness: Any) -> np.ndarray:
        """Compute the lowest squared natural frequencies; see `DenseWall.lowest`."""
        eigenvalues = scipy.sparse.linalg.eigsh(
            stiffness.tocsc(), k=MODES, M=self.matrices.mass.tocsc(), sigma=0.0, return_eigenvectors=False
        )
        return np.asarray(np.sort(eigenvalues))
