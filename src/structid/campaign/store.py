"""Runs on disk while a campaign goes on: a checksummed journal, sealed into HDF5 segments, put together into one file at the end.

An HDF5 file that is being appended to does not survive a kill or a full disk. So every finished run goes first to a journal; a full
journal is sealed into a segment, written whole and renamed; at the end the segments become one file, in the design's order:

    runs.h5.parts/design           the points, and what all runs share
    runs.h5.parts/journal          the newest runs, each on disk before the next result is awaited
    runs.h5.parts/segment-000001.h5  sealed runs
    runs.h5                        all runs, when the campaign has ended; the parts are gone then
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from structid.campaign import run_file
from structid.campaign.run_file import Header, Row
from structid.errors import InputError, Status, StoreError
from structid.journal import Journal, compare_identity, differences
from structid.probability.space import ParameterSpace
from structid.runs import InMemory, Runs
from structid.solvers.protocol import Outcome

CAMPAIGN_RUNS = "runs.h5"
"""File of a study's folder with the runs of its campaign."""
CALIBRATION_FOLDER, CALIBRATION_RUNS = "calibration", "true_runs.h5"
"""Folder of a study's folder with its calibration, and file of that with the runs."""
SEGMENT_BYTES = 64_000_000
"""A journal larger than this is sealed into a segment."""


@dataclass(frozen=True)
class Finished:
    """A run that has ended, on its way to the store.

    Parameters
    ----------
    key : str
        Stands for parameters and record.
    outcome : Outcome
        What became of it.
    attempts : int
        How often it was tried.
    """

    key: str
    outcome: Outcome
    attempts: int


class RunStore:
    """Where a campaign's runs are kept.

    Parameters
    ----------
    path : path-like
        The HDF5 file that is to be; its parts lie beside it.
    header : Header
        What the runs share; a store of anything else is refused.
    adopt : bool
        Take over the runs of another version of the model, if nothing else differs.

    Raises
    ------
    StoreMismatchError
        If the store belongs to something else; it is left alone.
    InputError
        If another process is writing to it.
    """

    def __init__(self, path: str | os.PathLike[str], header: Header, adopt: bool = False) -> None:
        self.path, self.header = Path(path), header
        self.parts = parts_of(self.path)
        found = self._found()
        other = [] if found is None else differences(found, header.identity)
        if found is not None and other != (["model"] if adopt else []):
            compare_identity(self.path, found, header.identity)
        with _plain_errors(self.path):
            self.parts.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(self.parts, self.path)
        if other:
            self._take_over()
        self._journal = Journal(self.parts / "journal", header.identity)
        self._designs = Journal(self.parts / "design", header.identity)
        self.rows: dict[str, Row] = {}
        for file in _files_of(self.path):
            self.rows.update(run_file.read_rows(file))
        for rows in _journalled(self._journal):
            self.rows.update(rows)

    def _found(self) -> dict[str, Any] | None:
        """Identity of what is there, if anything is."""
        if (self.parts / "design").exists():
            return Journal.read(self.parts / "design").identity
        return run_file.read_header(self.path)[0].identity if self.path.exists() else None

    def _take_over(self) -> None:
        """Put what another version of the model has done into one file under this one's name."""
        stored = _stored(self.path)
        run_file.write(self.path, self.header, stored.theta, stored.record_of_run, stored.rows)
        for part in self.parts.iterdir():
            if part.name != "lock":
                part.unlink()

    def describe(self, keys: Sequence[str], theta: np.ndarray, record_of_run: np.ndarray) -> None:
        """Put the design on disk, so that what is pending is known to whoever opens the store.

        Parameters
        ----------
        keys : sequence of str
            One for each run.
        theta : ndarray, shape (run, parameter)
            Points in SI.
        record_of_run : ndarray of int, shape (run,)
            Which record drives each.
        """
        with _plain_errors(self.path):
            self._designs.append(
                {
                    "key": np.array(keys, dtype="S16"),
                    "theta": theta,
                    "record_of_run": record_of_run,
                    "excitation": np.concatenate([r.values for r in self.header.records]),
                    "told": np.array(_told(self.header)),
                }
            )

    def append(self, finished: Sequence[Finished]) -> None:
        """Put finished runs on disk; they are safe there when this returns.

        Parameters
        ----------
        finished : sequence of Finished
            Runs that have ended.

        Raises
        ------
        StoreError
            If the disk is full or gone; what was stored before is safe.
        """
        if not finished:
            return
        entry = _entry(finished, self.header)
        with _plain_errors(self.path):
            self._journal.append(entry)
        # What is known of them stays in memory, their histories do not.
        self.rows.update(_rows_of(entry, source=None))
        if self._journal.size > SEGMENT_BYTES:
            self._seal()

    def _seal(self) -> None:
        """Turn the journal into a segment."""
        rows: dict[str, Row] = {}
        for some in _journalled(self._journal):
            rows.update(some)
        if rows:
            _, keys, theta, record_of_run = _design_in(self._designs, self.path)
            place = {key: i for i, key in enumerate(keys)}
            points = [place[key] for key in rows]
            segment = self._next_segment()
            run_file.write(segment, self.header, theta[points], record_of_run[points], list(rows.values()))
            self.rows.update(run_file.read_rows(segment))
        with _plain_errors(self.path):
            self._journal.remove()

    def _next_segment(self) -> Path:
        """Name the next segment: never one that is there, even where a kill has left some of an earlier campaign's."""
        last = max((int(p.stem.partition("-")[2]) for p in segments_of(self.path)), default=0)
        return self.parts / f"segment-{last + 1:06d}.h5"

    def finish(self, keys: Sequence[str], theta: np.ndarray, record_of_run: np.ndarray) -> Runs:
        """Put everything together into one file, in the design's order, and remove the parts.

        Parameters
        ----------
        keys : sequence of str
            One for each run.
        theta : ndarray, shape (run, parameter)
            Points in SI.
        record_of_run : ndarray of int, shape (run,)
            Which record drove each.

        Returns
        -------
        Runs
            Lying in that file.
        """
        self._seal()
        rows = _in_order(self.rows, keys)
        if any(r.source is not None and r.source.path != self.path for r in rows) or not _holds(self.path, keys):
            run_file.write(self.path, self.header, theta, record_of_run, rows)
        # While the lock is held: nobody else may have begun to fill the parts.
        shutil.rmtree(self.parts, ignore_errors=True)
        self.close()
        return open_runs(self.path)

    def close(self) -> None:
        """Let go of the store; everything stays as it is."""
        if self._lock is not None:
            if [p.name for p in self.parts.glob("*")] == ["lock"]:  # nothing was begun
                shutil.rmtree(self.parts, ignore_errors=True)
            os.close(self._lock)
            self._lock = None


class MemoryStore:
    """Runs of a campaign without a file: lost with the process.

    Parameters
    ----------
    header : Header
        What the runs share.
    """

    def __init__(self, header: Header) -> None:
        self.header = header
        self.rows: dict[str, Row] = {}

    def describe(self, keys: Sequence[str], theta: np.ndarray, record_of_run: np.ndarray) -> None:
        """Nothing is told; see `RunStore.describe`.

        Parameters
        ----------
        keys, theta, record_of_run
            As there.
        """

    def append(self, finished: Sequence[Finished]) -> None:
        """Keep finished runs.

        Parameters
        ----------
        finished : sequence of Finished
            Runs that have ended.
        """
        if finished:
            entry = _entry(finished, self.header)
            self.rows.update(_rows_of(entry, InMemory(entry["values"])))

    def finish(self, keys: Sequence[str], theta: np.ndarray, record_of_run: np.ndarray) -> Runs:
        """Give what there is; see `RunStore.finish`.

        Parameters
        ----------
        keys, theta, record_of_run
            As there.

        Returns
        -------
        Runs
            In memory.
        """
        rows = _in_order(self.rows, keys)
        return run_file.as_runs(self.header, theta, record_of_run, rows, _Scattered(rows, self.header), None)

    def close(self) -> None:
        """Nothing to let go of."""


def printable(text: str) -> str:
    """Make a text fit to be stored: whatever a solver prints, no file format chokes on it.

    Parameters
    ----------
    text : str
        What was said.

    Returns
    -------
    str
        The same, characters that cannot be printed replaced, tabs and line ends kept.
    """
    return "".join(c if c.isprintable() or c in "\n\t" else "�" for c in text)


def parts_of(path: Path) -> Path:
    """Return the folder of a store's parts.

    Parameters
    ----------
    path : Path
        The store.

    Returns
    -------
    Path
        ``runs.h5.parts``.
    """
    return path.with_name(path.name + ".parts")


def segments_of(path: Path) -> list[Path]:
    """Return the sealed segments of a store, oldest first.

    Parameters
    ----------
    path : Path
        The store.

    Returns
    -------
    list of Path
        The files.
    """
    return sorted(parts_of(path).glob("segment-*.h5"))


def _files_of(path: Path) -> list[Path]:
    """The finished file and the segments, oldest first."""
    return [p for p in (path, *segments_of(path)) if p.exists()]


def open_runs(path: str | os.PathLike[str]) -> Runs:
    """Open the runs of a campaign to read them, finished or not; nothing on disk is changed.

    Parameters
    ----------
    path : path-like
        The campaign's store.

    Returns
    -------
    Runs
        In the design's order. Of a campaign that has not ended, runs without a result are pending.

    Raises
    ------
    InputError
        If there is no such store.
    """
    path = Path(path)
    if path.is_dir():
        stores = [path / CAMPAIGN_RUNS, path / CALIBRATION_FOLDER / CALIBRATION_RUNS]
        path = next((s for s in stores if s.exists() or parts_of(s).exists()), stores[0])
    if not path.exists() and not parts_of(path).exists():
        raise InputError(
            f"{path}", "there is no such store", "a file that a Campaign has made, or the folder of a study with one"
        )
    stored = _settled(path)
    values = _Scattered(stored.rows, stored.header)
    finished = not (parts_of(path) / "design").exists()
    return run_file.as_runs(
        stored.header, stored.theta, stored.record_of_run, stored.rows, values, path if finished else None
    )


@dataclass(frozen=True, eq=False)
class _Stored:
    """Everything a store holds, one row for each point of its design."""

    header: Header
    theta: np.ndarray
    record_of_run: np.ndarray
    rows: list[Row]


def _settled(path: Path) -> _Stored:
    """Read a store that may be written to meanwhile: again, if parts of it were sealed or put together under our eyes."""
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
    return [str(p) for p in (*_files_of(path), journal) if p.exists()]


def _stored(path: Path) -> _Stored:
    parts = parts_of(path)
    found: dict[str, Row] = {}
    for file in _files_of(path):
        found.update(run_file.read_rows(file))
    if (parts / "design").exists():
        header, keys, theta, record_of_run = _design_in(Journal.read(parts / "design"), path)
    else:
        header, theta, record_of_run = run_file.read_header(path)
        keys = _keys_in(path)
    if (parts / "journal").exists():
        for some in _journalled(Journal.read(parts / "journal")):
            found.update(some)
    return _Stored(header, theta, record_of_run, _in_order(found, keys))


# --- entries of the journal -----------------------------------------------------------------------------------------


def _told(header: Header) -> str:
    """What a reader of the journal alone needs to know."""
    return json.dumps(
        {
            "space": header.space.to_plain(),
            "records": [r.to_plain() for r in header.records],
            "samples": [len(r) for r in header.records],
            "channels": header.channels,
        }
    )


def _design_in(journal: Journal, path: Path) -> tuple[Header, list[str], np.ndarray, np.ndarray]:
    entries = list(journal)
    if not entries:
        raise InputError(
            f"{path}", "its campaign was stopped before it began", "a store with runs", "Run the campaign again."
        )
    entry = entries[-1]  # a design that grew was told again
    told = json.loads(str(entry["told"]))
    ends = np.cumsum(told["samples"])
    parts = np.split(entry["excitation"], ends[:-1])
    records = tuple(run_file.record_from_plain(p, v) for p, v in zip(told["records"], parts, strict=True))
    header = Header(journal.identity, ParameterSpace.from_plain(told["space"]), records, tuple(told["channels"]))
    return header, [k.decode() for k in entry["key"]], entry["theta"], entry["record_of_run"].astype(int)


def _journalled(journal: Journal) -> Iterator[dict[str, Row]]:
    """Rows of every entry of a journal, their histories in memory."""
    for entry in journal:
        yield _rows_of(entry, InMemory(entry["values"]))


def _entry(finished: Sequence[Finished], header: Header) -> dict[str, np.ndarray]:
    """Runs that have ended, as they are journalled: one text and one array, since each array costs as much as 1000 numbers."""
    values = np.full((len(finished), header.samples, len(header.channels)), np.nan)
    told = []
    for row, run in zip(values, finished, strict=True):
        o = run.outcome
        row[: len(o.values)] = o.values
        reason = printable(o.reason)
        told.append([run.key, int(o.status), reason, o.failure_time, o.seconds, run.attempts, time.time()])
    return {"told": np.array(json.dumps(told)), "values": values}


def _rows_of(entry: dict[str, np.ndarray], source: Any) -> dict[str, Row]:
    rows = {}
    for position, told in enumerate(json.loads(str(entry["told"]))):
        key, status, reason, failure_time, seconds, attempts, finished = told
        rows[key] = Row(key, status, reason, failure_time, seconds, attempts, finished, source, position)
    return rows


def _in_order(rows: Mapping[str, Row], keys: Sequence[str]) -> list[Row]:
    """A row for each key; pending where there is none."""
    return [rows.get(key) or _pending(key) for key in keys]


def _pending(key: str) -> Row:
    return Row(key, int(Status.PENDING), "", np.nan, np.nan, 0, np.nan, None, 0)


@dataclass(frozen=True, eq=False)
class _Scattered:
    """Histories that lie in several places."""

    rows: Sequence[Row]
    header: Header

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.rows), self.header.samples, len(self.header.channels)

    def read(self, rows: np.ndarray) -> np.ndarray:
        values = np.full((len(rows), *self.shape[1:]), np.nan)
        wanted = [self.rows[i] for i in rows]
        places: dict[int, list[int]] = {}
        for i, row in enumerate(wanted):
            if row.source is not None:
                places.setdefault(id(row.source), []).append(i)
        for some in places.values():
            positions = np.array([wanted[i].position for i in some])
            values[some] = wanted[some[0]].source.read(positions)
        return values


def _keys_in(path: Path) -> list[str]:
    import h5py

    with h5py.File(path, "r") as file:
        return [k.decode() for k in file["key"][...]]


def _holds(path: Path, keys: Sequence[str]) -> bool:
    return path.exists() and _keys_in(path) == list(keys)


# --- the file system ------------------------------------------------------------------------------------------------


def _locked(folder: Path, path: Path) -> int | None:
    """Hold a folder against a second writer; the system lets it go when this process ends, however it ends."""
    # A file of its own, open for writing: network file systems lock nothing else.
    handle = os.open(folder / "lock", os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise InputError(
            f"store {path}",
            "another process is running this campaign",
            "one writer at a time",
            "Wait for it, or stop it.",
        ) from None
    except OSError:  # a file system without locks
        os.close(handle)
        return None
    try:
        same = os.path.samestat(os.fstat(handle), (folder / "lock").stat())
    except FileNotFoundError:
        same = False
    if not same:  # its last owner has just finished and removed it
        os.close(handle)
        folder.mkdir(parents=True, exist_ok=True)
        return _locked(folder, path)
    return handle


@contextlib.contextmanager
def _plain_errors(path: Path) -> Iterator[None]:
    """Say what a full or broken disk means for the campaign."""
    try:
        yield
    except OSError as problem:
        full = problem.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        what, cure = ("there is no room left", "Free some space") if full else ("it cannot be written", "Repair that")
        raise StoreError(
            f"{path}: {what} ({problem.strerror}). Every run that was stored before is safe. {cure} and run the same campaign "
            "again: it goes on from there."
        ) from problem
