"""NumPy (npy, npz) and MATLAB files (v5 by SciPy, v7.3 by mat73): variables as columns of a table."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy

from structid.core.errors import InputError
from structid.data_files.base import FileFormat, optional_library
from structid.data_files.file_content import FileContent
from structid.data_files.tables.column_table import ColumnTable

FEWEST_ROWS = 20
"""Number of samples below which a matrix with more columns than rows is probably transposed."""

_STEP_NAMES = ("dt", "delta_t", "time_step")
_RATE_NAMES = ("fs", "sampling_rate", "sample_rate", "sampling_frequency")


def _is_npy(content: FileContent) -> bool:
    return content.raw[:6] == b"\x93NUMPY"


def _is_npz(content: FileContent) -> bool:
    return content.raw[:4] == b"PK\x03\x04" and b".npy" in content.raw[:400]


def _is_matlab5(content: FileContent) -> bool:
    return content.raw[:19] == b"MATLAB 5.0 MAT-file"


def _is_matlab73(content: FileContent) -> bool:
    return content.raw[:19] == b"MATLAB 7.3 MAT-file"


def _read_npy(content: FileContent) -> ColumnTable:
    array = _load(content)
    if array.dtype.names:
        return _table(content, {name: array[name] for name in array.dtype.names})
    return _table(content, {"": array})


def _read_npz(content: FileContent) -> ColumnTable:
    return _table(content, dict(_load(content)))


def _load(content: FileContent) -> Any:
    try:
        return np.load(io.BytesIO(content.raw), allow_pickle=False)
    except Exception as cause:
        raise InputError(
            content.path, f"NumPy cannot read it: {cause}", "arrays of numbers", "Save the arrays again."
        ) from cause


def _read_matlab5(content: FileContent) -> ColumnTable:
    try:
        variables = scipy.io.loadmat(io.BytesIO(content.raw), squeeze_me=False)
    except Exception as cause:
        raise InputError(
            content.path, f"SciPy cannot read it: {cause}", "a MATLAB file", "Save the variables again."
        ) from cause
    return _table(content, {name: value for name, value in variables.items() if not name.startswith("__")})


def _read_matlab73(content: FileContent) -> ColumnTable:
    mat73 = optional_library(content, "mat73", "a MATLAB 7.3 file", "laboratory")
    try:
        variables = mat73.loadmat(content.path)
    except Exception as cause:
        raise InputError(
            content.path, f"mat73 cannot read it: {cause}", "a MATLAB file", "Save the variables again."
        ) from cause
    return _table(content, variables)


def _table(content: FileContent, variables: Mapping[str, Any]) -> ColumnTable:
    """Put the variables side by side; vectors are columns, and scalars with usual names give the time step."""
    step: float | None = None
    columns: list[np.ndarray] = []
    titles: list[str] = []
    for name, value in variables.items():
        array = np.asarray(value)
        if not (np.issubdtype(array.dtype, np.integer) or np.issubdtype(array.dtype, np.floating)):
            continue
        if array.size == 0:
            raise InputError(content.path, f"'{name or 'the array'}' is empty", "two or more samples", "Save it again.")
        if array.size == 1:
            step = _step(name, float(array.reshape(-1)[0]), step)
            continue
        array = array.reshape(-1, 1) if array.ndim == 1 or (1 in array.shape and array.ndim == 2) else array
        if array.ndim != 2:
            raise InputError(
                content.path,
                f"'{name}' has the shape {array.shape}",
                "vectors, or matrices (time, channel)",
                "Save one matrix.",
            )
        if array.shape[1] > array.shape[0] and array.shape[0] < FEWEST_ROWS:
            raise InputError(
                content.path,
                f"'{name or 'the array'}' has the shape {array.shape}",
                "a matrix (time, channel)",
                "Transpose it, so that each channel is a column.",
            )
        columns.extend(np.asarray(array, dtype=float).T)
        titles.extend(
            [name] if array.shape[1] == 1 else [f"{name}[{n}]" if name else "" for n in range(array.shape[1])]
        )
    lengths = {len(column) for column in columns}
    if len(lengths) != 1:
        held = ", ".join(f"{title or 'array'} ({len(column)})" for title, column in zip(titles, columns, strict=True))
        raise InputError(
            content.path,
            f"variables of different lengths: {held}" if columns else "no numbers",
            "vectors of one length",
            "Save vectors of one length in a file.",
        )
    values = np.stack(columns, axis=1)
    named = int(any(titles))
    return ColumnTable(
        content.path, values, list(range(1, len(values) + 1)), titles, [""] * len(titles), named, step=step
    )


def _step(name: str, value: float, so_far: float | None) -> float | None:
    """Return the time step [s] if a scalar has a usual name for it or for a rate."""
    if value > 0.0 and name.lower() in _STEP_NAMES:
        return value
    if value > 0.0 and name.lower() in _RATE_NAMES:
        return 1.0 / value
    return so_far


NPY = FileFormat("NumPy npy", _is_npy, _read_npy)
NPZ = FileFormat("NumPy npz", _is_npz, _read_npz)
MATLAB5 = FileFormat("MATLAB v5", _is_matlab5, _read_matlab5)
MATLAB73 = FileFormat("MATLAB v7.3", _is_matlab73, _read_matlab73)
