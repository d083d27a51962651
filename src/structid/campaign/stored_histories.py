"""Histories of runs on disk, each a compressed chunk with a checksum, and detection of damaged histories."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError, Status
from structid.core.journal import opened_hdf5


@dataclass(frozen=True)
class FileSource:
    """Histories in an HDF5 file with the package's layout."""

    path: Path  # the file

    def read(self, positions: np.ndarray) -> Float[np.ndarray, "row time channel"]:
        """Read the histories at the given positions."""
        with opened_hdf5(self.path, "histories of runs") as file:
            values = file["values"]
            # h5py needs increasing, distinct rows.
            distinct, back = np.unique(positions, return_inverse=True)
            try:
                return values[distinct][back] if len(distinct) else np.empty((0, *values.shape[1:]))
            except (OSError, RuntimeError) as cause:
                lost = _unreadable(values, range(len(values)))
                if len(lost) == len(values):
                    raise
                raise InputError(
                    f"{self.path}",
                    f"the histories of {len(lost)} of {len(values)} runs are damaged (run {', '.join(map(str, lost[:5]))}"
                    f"{', …' if len(lost) > 5 else ''}); the others are intact",
                    "an undamaged file",
                    "Run the campaign on this store again, or the study with --resume: only the damaged runs are repeated.",
                ) from cause


@functools.lru_cache(maxsize=256)
def damaged_rows(path: Path, changed: int, size: int) -> frozenset[int]:
    """Find the rows of a file with unreadable histories; check again only if the file has changed."""
    with opened_hdf5(path, "runs") as file:
        return frozenset(_unreadable(file["values"], np.flatnonzero(file["status"][...] != Status.PENDING)))


def _unreadable(values: Any, rows: Iterable[int]) -> list[int]:
    """Return the rows whose compressed data fail their checksum."""
    lost = []
    for row in rows:
        try:
            values[row]
        except (OSError, RuntimeError):
            lost.append(int(row))
    return lost
