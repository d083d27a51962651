"""Displacements on a regular grid, as measured by digital image correlation, and their strains."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from structid.core.errors import InputError
from structid.core.units import factor_of
from structid.core.validation import check_arguments

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("x", "y", "ux", "uy")
"""Required columns of a table, or datasets of an HDF5 file; ``time`` is optional."""


def von_mises_strain(strain_x: Any, strain_y: Any, shear: Any) -> Any:
    """Compute the von Mises strain in the plane, ε_v = √(ε_x² − ε_x ε_y + ε_y² + ¾ γ_xy²).

    In principal strains it is √(ε₁² − ε₁ ε₂ + ε₂²). For a stretched bar it is the axial strain.
    """
    return np.sqrt(strain_x**2 - strain_x * strain_y + strain_y**2 + 0.75 * shear**2)


@check_arguments
@dataclass(frozen=True, eq=False)
class DisplacementField:
    """Displacements on a regular grid at several instants.

    Parameters
    ----------
    time : ndarray, shape (time,)
        Instants [s].
    x : ndarray, shape (column,)
        Coordinates of the columns [m], increasing.
    y : ndarray, shape (row,)
        Coordinates of the rows [m], increasing.
    ux, uy : ndarray, shape (time, row, column)
        Displacements [m]; NaN without a measurement, such as in an opening.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> x, y = np.array([0.0, 0.5, 1.0]), np.array([0.0, 1.0])
    >>> ux = 0.001 * np.tile(y[:, None], (1, 3))  # sheared by 1 mm over 1 m
    >>> field = si.DisplacementField(np.zeros(1), x, y, ux[None], np.zeros((1, 2, 3)))
    >>> field.ux.shape
    (1, 2, 3)
    """

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    ux: np.ndarray = field(repr=False)
    uy: np.ndarray = field(repr=False)

    def __post_init__(self) -> None:
        shape = (len(self.time), len(self.y), len(self.x))
        for name in ("ux", "uy"):
            if getattr(self, name).shape != shape:
                raise InputError(
                    f"DisplacementField.{name}", f"shape {getattr(self, name).shape}", f"(time, row, column) = {shape}"
                )
        if min(shape[1:]) < 2:
            raise InputError("DisplacementField", f"{shape[1]} rows and {shape[2]} columns", "at least two of each")
        for name in ("x", "y"):
            steps = np.diff(getattr(self, name))
            if not (steps > 0.0).all():
                raise InputError(f"DisplacementField.{name}", "not increasing", "increasing coordinates")

    @classmethod
    @check_arguments
    def read(cls, path: str | os.PathLike[str], length_unit: str = "m") -> DisplacementField:
        """Read a displacement field.

        Parameters
        ----------
        path : path-like
            A table in a text file, with the column names ``x``, ``y``, ``ux``, ``uy`` and, for several instants, ``time`` in the
            first line. Or an HDF5 file with datasets of these names; ``ux`` and ``uy`` have shape (time, row, column).
        length_unit : str
            Unit of coordinates and displacements. Times are in seconds.

        Returns
        -------
        DisplacementField
            The field; grid points that are missing in a table are NaN.

        Raises
        ------
        InputError
            If there is no such file, a column is missing, or a point is given twice.
        """
        file = Path(path)
        if not file.is_file():
            raise InputError(f"{path}", "there is no such file", "a text or HDF5 file with a displacement field")
        unit = factor_of(length_unit, "m", "DisplacementField.read(length_unit)")
        return _of_hdf5(file, unit) if h5py.is_hdf5(file) else _of_table(file, unit)

    def strains(self, instant: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute small strains at an instant from differences between neighbouring points.

        Parameters
        ----------
        instant : int
            Number of the instant.

        Returns
        -------
        tuple of ndarray, shape (row − 1, column − 1)
            ε_x, ε_y, γ_xy in the middle of every cell of four points. Across an open
            joint, the strain is the displacement jump divided by the grid step.
        """

        def slopes(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            along = np.diff(u, axis=1) / np.diff(self.x)
            up = np.diff(u, axis=0) / np.diff(self.y)[:, None]
            return 0.5 * (along[1:] + along[:-1]), 0.5 * (up[:, 1:] + up[:, :-1])

        (ux_x, ux_y), (uy_x, uy_y) = slopes(self.ux[instant]), slopes(self.uy[instant])
        return ux_x, uy_y, ux_y + uy_x

    def von_mises(self, instant: int) -> np.ndarray:
        """Compute the von Mises strain at an instant; see `von_mises_strain`.

        Parameters
        ----------
        instant : int
            Number of the instant.

        Returns
        -------
        ndarray, shape (row − 1, column − 1)
            Strain in the middle of every cell of four points.
        """
        return np.asarray(von_mises_strain(*self.strains(instant)))

    def plot(self, instants: list[int] | None = None, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw maps of the von Mises strain.

        Parameters
        ----------
        instants : list of int, optional
            Indices of the instants; all instants by default.
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        Figure
            A map for each instant.
        """
        from structid.figures import wall as figures

        chosen = list(range(len(self.time))) if instants is None else instants
        maps = [self.von_mises(i) for i in chosen]
        titles = [f"{self.time[i]:.3f} s" for i in chosen]
        return figures.strain_maps(self.x, self.y, maps, titles, save=save)


def _of_hdf5(file: Path, unit: float) -> DisplacementField:
    with h5py.File(file) as store:
        _refuse_missing(file, set(store))
        x, y, ux, uy = (np.asarray(store[name], dtype=float) * unit for name in COLUMNS)
        ux, uy = (u[None] if u.ndim == 2 else u for u in (ux, uy))
        time = np.atleast_1d(np.asarray(store["time"], dtype=float)) if "time" in store else np.arange(len(ux)) * 1.0
    return DisplacementField(time, x, y, ux, uy)


def _of_table(file: Path, unit: float) -> DisplacementField:
    with file.open(encoding="utf-8-sig") as lines:
        head = lines.readline().strip()
        names = [name.strip().strip('"').lower() for name in head.lstrip("#").replace(";", ",").split(",")]
        _refuse_missing(file, set(names))
        try:
            rows = np.array([[float(v) for v in line.replace(";", ",").split(",")] for line in lines if line.strip()])
        except ValueError as cause:
            raise InputError(
                f"{file}", f"{cause}", "numbers separated by commas or semicolons, below a line of column names"
            ) from None
    if rows.ndim != 2 or rows.shape[1] != len(names):
        raise InputError(f"{file}", "rows of different lengths, or no rows", f"rows of {len(names)} numbers")
    columns = dict(zip(names, rows.T, strict=True))
    times, instant = np.unique(columns.get("time", np.zeros(len(rows))), return_inverse=True)
    (x, column), (y, row) = (np.unique(columns[name] * unit, return_inverse=True) for name in ("x", "y"))
    index = (instant, row, column)
    if len(np.unique(np.stack(index), axis=1).T) < len(rows):
        raise InputError(f"{file}", "a point is given twice at one time", "each point once at each time")
    fields = np.full((2, len(times), len(y), len(x)), np.nan)
    for number, name in enumerate(("ux", "uy")):
        fields[number][index] = columns[name] * unit
    return DisplacementField(times, x, y, *fields)


def _refuse_missing(file: Path, names: set[str]) -> None:
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise InputError(
            f"{file}", f"no {', '.join(missing)} among {', '.join(sorted(names)) or 'no names'}", ", ".join(COLUMNS)
        )
