"""Displacement and force of a loop, from two columns of a table."""

from __future__ import annotations

import os

import numpy as np
from jaxtyping import Float

from structid.data_files.read_file import read_table
from structid.data_files.tables.pick_column import values_of_column


def read_loop_columns(
    path: str | os.PathLike[str],
    displacement_unit: str,
    force_unit: str,
    displacement_column: int | str,
    force_column: int | str,
    gaps: bool = False,
) -> tuple[Float[np.ndarray, " row"], Float[np.ndarray, " row"]]:
    """Return displacement [m] and force [N]; with `gaps`, empty cells are NaN, otherwise they are refused."""
    table = read_table(path)
    return (
        values_of_column(table, displacement_column, displacement_unit, "m", gaps),
        values_of_column(table, force_column, force_unit, "N", gaps),
    )
