"""The store of a campaign's runs: a checksummed journal, sealed into HDF5 segments, merged into one file at the end.

An HDF5 file does not survive a kill or a full disk while it is being extended. Every finished run is therefore written to a
journal first. A full journal is sealed into a segment, which is written under another name and renamed when complete. At the end
the segments are merged into one file, in the order of the design:

    runs.h5.parts/design             the points, and the common data of all runs
    runs.h5.parts/journal            the newest runs, each on disk before the next result is awaited
    runs.h5.parts/segment-000001.h5  sealed runs
    runs.h5                          all runs, after the end of the campaign; the parts are removed then
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from structid.campaign import run_file
from structid.campaign.journal_entries import (
    Finished,
    design_entry,
    journalled_rows,
    read_design,
    rows_of,
    runs_entry,
)
from structid.campaign.parts import disk_errors_explained, lock, next_segment, parts_of, run_files_of
from structid.campaign.run_file import Header, Row
from structid.campaign.runs import Runs, StoredInMemory
from structid.core.errors import InputError, Status
from structid.core.journal import Journal, compare_identity, differences
from structid.core.validation import check_arguments

CAMPAIGN_RUNS = "runs.h5"
"""File with the runs of a campaign, in the folder of its study."""
CALIBRATION_FOLDER = "calibration"
"""Folder of a calibration in the folder of its study."""
CALIBRATION_RUNS = "true_runs.h5"
"""File with the model runs of a calibration."""
CALIBRATION_FINISHED = "finished"
"""File in the calibration folder that marks the last draws as complete."""
ADOPTED = {"model", "engine"}
"""Keys of the identity in which adopted runs may differ."""
SEGMENT_BYTES = 64_000_000
"""Size of a journal above which it is sealed into a segment [byte]."""


def stored_identity(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Read the identity of the stored runs."""
    parts = parts_of(Path(path))
    if (parts / "design").exists():
        return Journal.read(parts / "design").identity
    return run_file.read_header(Path(path))[0].identity if Path(path).exists() else None


class RunStore:
    """The runs of a campaign on disk."""

    def __init__(self, path: str | os.PathLike[str], header: Header, adopt: bool = False) -> None:
        self.path, self.header = Path(path), header
        self.parts = parts_of(self.path)
        result = stored_identity(self.path)
        other = [] if result is None else differences(result, header.identity)
        if result is not None and not set(other) <= (ADOPTED if adopt else set()):
            compare_identity(self.path, result, header.identity)
        with disk_errors_explained(self.path):
            self.parts.mkdir(parents=True, exist_ok=True)
            self._lock = lock(self.parts, self.path)
        if other:
            self._take_over()
        self._journal = Journal(self.parts / "journal", header.identity)
        self._designs = Journal(self.parts / "design", header.identity)
        self.rows: dict[str, Row] = {}
        for file in run_files_of(self.path):
            self.rows.update(run_file.sound_rows(file))
        for rows in journalled_rows(self._journal):
            self.rows.update(rows)

    def _take_over(self) -> None:
        """Merge the runs of another version of the model into one file with the identity of this version."""
        stored = _stored(self.path)
        run_file.write(self.path, self.header, stored.theta, stored.record_of_run, stored.rows)
        for part in self.parts.iterdir():
            if part.name != "lock":
                part.unlink()

    def describe(
        self, keys: Sequence[str], theta: Float[np.ndarray, "run parameter"], record_of_run: Int[np.ndarray, " run"]
    ) -> None:
        """Write the design to disk, so that every reader of the store can list the pending runs."""
        with disk_errors_explained(self.path):
            self._designs.append(design_entry(self.header, keys, theta, record_of_run))

    def append(self, finished: Sequence[Finished]) -> None:
        """Write completed runs; they are on disk when the method returns."""
        if not finished:
            return
        entry = runs_entry(finished, self.header)
        with disk_errors_explained(self.path):
            self._journal.append(entry)
        # Keep the rows in memory, but not the histories.
        self.rows.update(rows_of(entry, source=None))
        if self._journal.size > SEGMENT_BYTES:
            self._seal()

    def _seal(self) -> None:
        """Turn the journal into a segment."""
        rows: dict[str, Row] = {}
        for some in journalled_rows(self._journal):
            rows.update(some)
        if rows:
            _, keys, theta, record_of_run = read_design(self._designs, self.path)
            row_of_key = {key: i for i, key in enumerate(keys)}
            points = [row_of_key[key] for key in rows]
            segment = next_segment(self.path)
            run_file.write(segment, self.header, theta[points], record_of_run[points], list(rows.values()))
            self.rows.update(run_file.read_rows(segment))
        with disk_errors_explained(self.path):
            self._journal.remove()

    def finish(
        self, keys: Sequence[str], theta: Float[np.ndarray, "run parameter"], record_of_run: Int[np.ndarray, " run"]
    ) -> Runs:
        """Merge all parts into one file, in the order of the design, and remove the parts."""
        self._seal()
        rows = _in_order(self.rows, keys)
        if any(r.source is not None and r.source.path != self.path for r in rows) or not _holds(self.path, keys):
            run_file.write(self.path, self.header, theta, record_of_run, rows)
        # Remove the folder while the lock is held, so that no other process can start to fill it.
        shutil.rmtree(self.parts, ignore_errors=True)
        self.close()
        return open_runs(self.path)

    def close(self) -> None:
        """Release the store without changing it."""
        if self._lock is not None:
            if [p.name for p in self.parts.glob("*")] == ["lock"]:  # nothing was written
                shutil.rmtree(self.parts, ignore_errors=True)
            os.close(self._lock)
            self._lock = None


class MemoryStore:
    """The runs of a campaign in memory only."""

    def __init__(self, header: Header) -> None:
        self.header = header
        self.rows: dict[str, Row] = {}

    def describe(self, keys: Sequence[str], theta: np.ndarray, record_of_run: np.ndarray) -> None:
        """Do nothing; see `RunStore.describe`."""

    def append(self, finished: Sequence[Finished]) -> None:
        """Keep completed runs."""
        if finished:
            entry = runs_entry(finished, self.header)
            self.rows.update(rows_of(entry, StoredInMemory(entry["values"])))

    def finish(self, keys: Sequence[str], theta: np.ndarray, record_of_run: np.ndarray) -> Runs:
        """Return the runs in the order of the design; see `RunStore.finish`."""
        rows = _in_order(self.rows, keys)
        return run_file.as_runs(self.header, theta, record_of_run, rows, _Scattered(rows, self.header), None)

    def close(self) -> None:
        """Do nothing."""


@check_arguments
def open_runs(path: str | os.PathLike[str]) -> Runs:
    """Open the runs of a finished or unfinished campaign for reading; nothing on disk is changed.

    Parameters
    ----------
    path : path-like
        The store of the campaign, or the folder of a study.

    Returns
    -------
    Runs
        Runs in the order of the design. Runs without a result are pending.

    Raises
    ------
    InputError
        If there is no store at `path`.

    Examples
    --------
    >>> import structid as si
    >>> runs = si.open_runs("runs.h5")  # doctest: +SKIP
    """
    path = Path(path)
    if path.is_dir():
        stores = [path / CAMPAIGN_RUNS, path / CALIBRATION_FOLDER / CALIBRATION_RUNS]
        path = next((s for s in stores if s.exists() or parts_of(s).exists()), stores[0])
    if not path.exists() and not parts_of(path).exists():
        raise InputError(
            f"{path}", "there is no such store", "the store of a Campaign, or the folder of a study with such a store"
        )
    stored = _settled(path)
    values = _Scattered(stored.rows, stored.header)
    finished = not (parts_of(path) / "design").exists()
    return run_file.as_runs(
        stored.header, stored.theta, stored.record_of_run, stored.rows, values, path if finished else None
    )


@dataclass(frozen=True, eq=False)
class _Stored:
    """The content of a store, one row for each point of its design."""

    header: Header
    theta: np.ndarray
    record_of_run: np.ndarray
    rows: list[Row]


def _settled(path: Path) -> _Stored:
    """Read a store that another process may be writing; read it again if its files change meanwhile."""
    for _ in range(20):
        before = _layout(path)
        try:
            stored = _stored(path)
        except (FileNotFoundError, InputError):
            if _layout(path) == before:
                raise
            continue
        if _layout(path) == before:
            break
    return stored


def _layout(path: Path) -> list[str]:
    journal = parts_of(path) / "journal"
    return [str(p) for p in (*run_files_of(path), journal) if p.exists()]


def _stored(path: Path) -> _Stored:
    parts = parts_of(path)
    result: dict[str, Row] = {}
    for file in run_files_of(path):
        result.update(run_file.read_rows(file))
    if (parts / "design").exists():
        header, keys, theta, record_of_run = read_design(Journal.read(parts / "design"), path)
    else:
        header, theta, record_of_run = run_file.read_header(path)
        keys = run_file.read_keys(path)
    if (parts / "journal").exists():
        for some in journalled_rows(Journal.read(parts / "journal")):
            result.update(some)
    return _Stored(header, theta, record_of_run, _in_order(result, keys))


def _in_order(rows: Mapping[str, Row], keys: Sequence[str]) -> list[Row]:
    """Return the row of each key, or a pending row if there is none."""
    return [rows.get(key) or _pending(key) for key in keys]


def _pending(key: str) -> Row:
    return Row(key, int(Status.PENDING), "", np.nan, np.nan, 0, np.nan, None, 0)


@dataclass(frozen=True, eq=False)
class _Scattered:
    """Histories from several sources."""

    rows: Sequence[Row]
    header: Header

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.rows), self.header.samples, len(self.header.channels)

    def read(self, rows: np.ndarray) -> np.ndarray:
        values = np.full((len(rows), *self.shape[1:]), np.nan)
        rows_wanted = [self.rows[i] for i in rows]
        places: dict[int, list[int]] = {}
        for i, row in enumerate(rows_wanted):
            if row.source is not None:
                places.setdefault(id(row.source), []).append(i)
        for some in places.values():
            positions = np.array([rows_wanted[i].position for i in some])
            values[some] = rows_wanted[some[0]].source.read(positions)
        return values


def _holds(path: Path, keys: Sequence[str]) -> bool:
    return path.exists() and run_file.read_keys(path) == list(keys)
