"""Sparse matrix products and linear solves with one sparsity pattern for all runs; vector code loops over the pattern.

In JAX these operations are dense, and their vector code would include all zeros. Inside `row_by_row`, which marks a
trace for vector code, the primitives below replace them; the translator supports these primitives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching
from jaxtyping import Bool, Float, Int

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.engine.matrices.elimination import Elimination, elimination
from structid.engine.matrices.row_by_row import in_rows


@dataclass(frozen=True, eq=False)
class SparseMatrix:
    """A matrix that all runs share."""

    dense: Float[np.ndarray, "row column"] = field(repr=False)  # the matrix as a dense array

    def times(self, x: Float[Array, "column run"]) -> Float[Array, "row run"]:
        """Compute A x, inside JAX."""
        return sparse_times.bind(x, matrix=self) if in_rows() else jnp.asarray(self.dense) @ x


@dataclass(frozen=True, eq=False)
class BlockPattern:
    """Pattern of the 2 × 2 blocks of a square matrix that may be nonzero."""

    # Row of each block. The pattern contains the diagonal, and with (i, j) also (j, i)
    rows: Int[np.ndarray, " block"] = field(repr=False)
    # Column of each block. The pattern contains the diagonal, and with (i, j) also (j, i)
    columns: Int[np.ndarray, " block"] = field(repr=False)
    size: int  # Number of block rows

    @classmethod
    def of(cls, touching: Bool[np.ndarray, "size size"]) -> BlockPattern:
        """Derive the pattern from a Boolean matrix of the nonzero blocks."""
        rows, columns = np.nonzero(touching | np.eye(len(touching), dtype=bool))
        return cls(rows, columns, len(touching))

    def dense(self, blocks: Float[Array, "block 2 2 run"]) -> Float[Array, "run _ _"]:
        """Assemble a dense matrix, inside JAX."""
        runs = blocks.shape[-1]
        zeros = jnp.zeros((self.size, self.size, 2, 2, runs))
        placed = zeros.at[self.rows, self.columns].set(blocks)
        return placed.transpose(4, 0, 2, 1, 3).reshape(runs, 2 * self.size, 2 * self.size)

    def times(self, blocks: Float[Array, "block 2 2 run"], x: Float[Array, "_ run"]) -> Float[Array, "_ run"]:
        """Compute A x, inside JAX."""
        if in_rows():
            return block_times.bind(blocks, x, pattern=self)
        return self._times_densely(blocks, x)

    def _times_densely(self, blocks: Any, x: Any) -> Any:
        return jnp.einsum("rij,jr->ir", self.dense(blocks), x)

    def solve_one_plus(
        self,
        blocks: Float[Array, "block 2 2 run"],
        diagonal: Float[Array, "size 2 2 run"],
        right: Float[Array, "_ run"],
    ) -> Float[Array, "_ run"]:
        """Solve (I + A D) x = b, inside JAX."""
        if in_rows():
            return block_solve.bind(blocks, diagonal, right, pattern=self)
        return self._solve_densely(blocks, diagonal, right)

    def _solve_densely(self, blocks: Any, diagonal: Any, right: Any) -> Any:
        product = self.dense(jnp.einsum("bijr,bjkr->bikr", blocks, diagonal[self.columns]))
        return jnp.linalg.solve(jnp.eye(2 * self.size) + product, right.T[:, :, None])[:, :, 0].T

    @cached_property
    def plan(self) -> Elimination:
        """Plan of the elimination."""
        return elimination(self.rows, self.columns, self.size)


# --- primitives -----------------------------------------------------------------------------------------------------

sparse_times, block_times, block_solve = (Primitive(name) for name in ("sparse_times", "block_times", "block_solve"))

AXES = {sparse_times: (2,), block_times: (4, 2), block_solve: (4, 4, 2)}
"""Number of axes of each operand; an additional first axis may hold several directions of differentiation."""


def _define(primitive: Any, rows_of: Callable[..., int]) -> None:
    """Register the shapes and the batching of a primitive with JAX."""

    def shape(*arrays: Any, **parameters: Any) -> Any:
        leading = [a.shape[0] for a, axes in zip(arrays, AXES[primitive], strict=True) if len(a.shape) > axes]
        return jax.core.ShapedArray((*leading[:1], rows_of(**parameters), arrays[-1].shape[-1]), arrays[-1].dtype)

    def directions(arrays: Any, axes: Any, **parameters: Any) -> tuple[Any, int]:
        first = [a if axis is None else jnp.moveaxis(a, axis, 0) for a, axis in zip(arrays, axes, strict=True)]
        return primitive.bind(*first, **parameters), 0

    primitive.def_abstract_eval(shape)
    batching.primitive_batchers[primitive] = directions


# These implementations apply to numbers known at compile time.
sparse_times.def_impl(lambda x, matrix: jnp.asarray(matrix.dense) @ x)
block_times.def_impl(lambda blocks, x, pattern: pattern._times_densely(blocks, x))
block_solve.def_impl(lambda blocks, diagonal, right, pattern: pattern._solve_densely(blocks, diagonal, right))

_define(sparse_times, lambda matrix: len(matrix.dense))
_define(block_times, lambda pattern: 2 * pattern.size)
_define(block_solve, lambda pattern: 2 * pattern.size)


def _each_slope(primitive: Any) -> Callable[..., Any]:
    """Return the derivative rules of a primitive that is linear in each operand."""

    def slope(place: int) -> Callable[..., Any]:
        return lambda tangent, *arrays, **parameters: primitive.bind(
            *arrays[:place], tangent, *arrays[place + 1 :], **parameters
        )

    return slope


for _operation in (sparse_times, block_times):
    ad.defjvp(_operation, *map(_each_slope(_operation), range(len(AXES[_operation]))))
