"""Products with large matrices that all runs share, computed in vector code by loops over the rows."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from typing import Any

from jax import lax
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp

_row_by_row = ContextVar("row by row", default=False)


@contextlib.contextmanager
def row_by_row() -> Iterator[None]:
    """Trace matrix products in this context as loops over rows."""
    token = _row_by_row.set(True)
    try:
        yield
    finally:
        _row_by_row.reset(token)


def in_rows() -> bool:
    """Whether the current trace is for vector code."""
    return _row_by_row.get()


COLUMNS = 6
"""Number of columns of a product that one loop over rows computes, so that their sums stay in registers."""


def product(values: Float[Array, "run row"], matrix: Float[Array, "row column"]) -> Float[Array, "run column"]:
    """Compute X B, inside JAX."""
    if matrix.shape[0] == 1:
        return values * matrix
    return _by_rows(values.T, matrix) if _row_by_row.get() else values @ matrix


def product_of(
    columns_of: Callable[[Any], Any], rows: Float[Array, "row ..."], matrix: Float[Array, "row column"]
) -> Float[Array, "run column"]:
    """Compute X B inside JAX; `columns_of` computes the columns of X from `rows`, one row for each row of B."""
    if not _row_by_row.get():
        return columns_of(rows) @ matrix
    _, columns = lax.scan(lambda _, row: (None, columns_of(row[None])[:, 0]), None, rows)
    return _by_rows(columns, matrix)


def _by_rows(columns: Any, matrix: Any) -> Any:
    """Compute X B by loops over the rows of B; `columns` is Xᵀ, shape (row, run)."""
    (rows, count), runs = matrix.shape, columns.shape[1]
    padded = jnp.pad(matrix, ((0, 0), (0, -count % COLUMNS)))
    blocks = padded.reshape(rows, -1, COLUMNS).transpose(1, 0, 2)

    def step(total: Any, row: tuple[Any, Any]) -> tuple[Any, None]:
        return total + row[0][:, None] * row[1], None

    def of_block(_: None, block: Any) -> tuple[None, Any]:
        return None, lax.scan(step, jnp.zeros((runs, COLUMNS)), (columns, block))[0]

    _, sums = lax.scan(of_block, None, blocks)
    return sums.transpose(1, 0, 2).reshape(runs, -1)[:, :count]
