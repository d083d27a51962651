"""Runs in one HDF5 file in netCDF layout. Each run is one compressed chunk that can be read or copied separately."""

from __future__ import annotations

import json
import os
import shutil
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Float, Int

from structid.campaign.runs import Runs
from structid.campaign.stored_histories import FileSource, damaged_rows
from structid.core.errors import InputError, Status, StoreError, StructidWarning
from structid.core.journal import opened_hdf5
from structid.ground_motion.excitation import (
    CombinedExcitation,
    DisplacementHistory,
    Excitation,
    ForceHistory,
    RotationHistory,
    padded_values,
)
from structid.ground_motion.record import GroundMotion
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace

SCHEMA = 2
"""Version of the file layout. Files of version 1 remain readable; they have no runs with `Status.STRUCTURE_FAILED`."""

_KINDS: dict[str, type[Excitation]] = {
    kind.kind: kind for kind in (Excitation, GroundMotion, ForceHistory, DisplacementHistory, RotationHistory)
}
_TEXT = h5py.string_dtype()


@dataclass(frozen=True, eq=False)
class Header:
    """Common data of all runs in a store."""

    identity: dict[str, Any]  # hashes and names; a store with a different identity is refused
    space: ParameterSpace  # space of the design
    records: tuple[Excitation, ...]
    channels: tuple[str, ...]  # channels of the histories

    @property
    def samples(self) -> int:
        """Number of samples of a history, equal to the length of the longest record."""
        return max(len(r) for r in self.records)

    @property
    def bytes_per_run(self) -> int:
        """Size of a history before compression [byte]."""
        return 8 * self.samples * len(self.channels)


@dataclass(frozen=True)
class Row:
    """One stored run: its outcome, and the location of its history."""

    key: str  # identifies point and record
    status: int
    reason: str  # reason of failure
    failure_time: float  # time of failure [s]
    seconds: float  # wall time [s]
    attempts: int  # number of attempts
    finished: float  # end time, in seconds since the epoch
    source: Any  # location of the history; None for a pending run
    position: int  # row of the history in the source


def sound_rows(path: Path) -> dict[str, Row]:
    """Read the outcome of every run with a readable history; warn of unreadable histories."""
    rows, state = read_rows(path), path.stat()
    lost = damaged_rows(path, state.st_mtime_ns, state.st_size)
    if lost:
        warnings.warn(
            StructidWarning(
                f"{path}: the histories of {len(lost)} of {len(rows)} runs are damaged. "
                "The damaged runs are repeated; the others are intact."
            ),
            stacklevel=2,
        )
    return {key: row for key, row in rows.items() if row.position not in lost}


def write(
    path: Path,
    header: Header,
    theta: Float[np.ndarray, "run parameter"],
    record_of_run: Int[np.ndarray, " run"],
    rows: Sequence[Row],
) -> None:
    """Write a file of runs, completely or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _check_room(path, header, rows)
    partial = path.with_name(path.name + ".partial")
    try:
        with h5py.File(partial, "w") as file:
            _write_header(file, header, theta, record_of_run)
            _write_rows(file, rows)
            _write_values(file, header, rows)
        with partial.open("rb+") as written:
            os.fsync(written.fileno())
        partial.replace(path)
    except (OSError, RuntimeError) as problem:  # h5py raises a RuntimeError if the disk is full when the file is closed
        partial.unlink(missing_ok=True)
        raise StoreError(
            f"{path}: it cannot be written ({problem}). The runs are safe in the existing files of the "
            "store. Free some space and continue."
        ) from problem


def _check_room(path: Path, header: Header, rows: Sequence[Row]) -> None:
    """Check the free disk space before writing, because a full disk can crash the HDF5 library."""
    needed = 1_000_000
    for source in {row.source for row in rows if row.source is not None}:
        if isinstance(source, FileSource):
            needed += source.path.stat().st_size
        else:
            needed += source.array.nbytes
    free = shutil.disk_usage(path.parent).free
    if free < needed:
        raise StoreError(
            f"{path}: {free / 1e6:.0f} MB are free, but merging the runs needs {needed / 1e6:.0f} MB. The runs are safe in "
            "the existing files of the store. Free some space and continue."
        )


def _write_header(file: Any, header: Header, theta: np.ndarray, record_of_run: np.ndarray) -> None:
    file.attrs["schema"] = SCHEMA
    file.attrs["identity"] = json.dumps(header.identity, sort_keys=True)
    file.attrs["space"] = json.dumps(header.space.to_plain())
    file.attrs["records"] = json.dumps([r.to_plain() for r in header.records])
    dt = {r.dt for r in header.records}
    scales = {
        "channel": np.array(header.channels, dtype=object),
        "parameter": np.array(header.space.names, dtype=object),
        "record": np.array([r.name for r in header.records], dtype=object),
        "time": np.arange(header.samples) * (dt.pop() if len(dt) == 1 else 1.0),
        "run": np.arange(len(theta)),
    }
    excitation = padded_values(header.records)
    if excitation.ndim == 3:
        scales["part"] = np.arange(excitation.shape[2])
    for name, content in scales.items():
        file.create_dataset(name, data=content, dtype=_TEXT if content.dtype == object else None).make_scale(name)
    _put(file, "theta", theta, ("run", "parameter"))
    _put(file, "record_of_run", np.asarray(record_of_run, dtype=np.int32), ("run",))
    _put(file, "excitation", excitation, ("record", "time", "part")[: excitation.ndim])
    _put(file, "dt", np.array([r.dt for r in header.records]), ("record",))
    _put(file, "samples", np.array([len(r) for r in header.records]), ("record",))


def _write_rows(file: Any, rows: Sequence[Row]) -> None:
    columns = {
        "key": np.array([row.key for row in rows], dtype="S16"),
        "status": np.array([row.status for row in rows], dtype=np.int8),
        "attempts": np.array([row.attempts for row in rows], dtype=np.int16),
        "failure_time": np.array([row.failure_time for row in rows], dtype=float),
        "seconds": np.array([row.seconds for row in rows], dtype=float),
        "finished": np.array([row.finished for row in rows], dtype=float),
        "reason": np.array([row.reason for row in rows], dtype=object),
    }
    for name, column in columns.items():
        _put(file, name, column, ("run",))
    file["status"].attrs["flag_meanings"] = " ".join(s.name.lower() for s in Status)


def _write_values(file: Any, header: Header, rows: Sequence[Row]) -> None:
    """Write the histories: copy the compressed chunks of other files, and compress the histories in memory."""
    shape = (header.samples, len(header.channels))
    values = file.create_dataset(
        "values",
        shape=(len(rows), *shape),
        chunks=(1, *shape),
        dtype="f8",
        fillvalue=np.nan,
        shuffle=True,
        compression="gzip",
        compression_opts=1,
    )
    _attach(file, values, ("run", "time", "channel"))
    # Read one source at a time, so that only one other file is open for any number of segments.
    by_source: dict[int, list[int]] = {}
    for index, row in enumerate(rows):
        if row.source is not None:
            by_source.setdefault(hash(row.source), []).append(index)
    for places in by_source.values():
        source = rows[places[0]].source
        if isinstance(source, FileSource):
            with h5py.File(source.path, "r") as other:
                chunks = other["values"].id
                for index in places:
                    mask, chunk = chunks.read_direct_chunk((rows[index].position, 0, 0))
                    values.id.write_direct_chunk((index, 0, 0), chunk, mask)
        else:
            for index in places:
                values[index] = rows[index].source.read(np.array([rows[index].position]))[0]


def _put(file: Any, name: str, data: np.ndarray, dimensions: tuple[str, ...]) -> None:
    kind = _TEXT if data.dtype == object else None
    _attach(file, file.create_dataset(name, data=data, dtype=kind), dimensions)


def _attach(file: Any, dataset: Any, dimensions: tuple[str, ...]) -> None:
    for axis, name in enumerate(dimensions):
        dataset.dims[axis].attach_scale(file[name])


def read_rows(path: Path) -> dict[str, Row]:
    """Read the outcome of every run in a file."""
    source = FileSource(path)
    with opened_hdf5(path, "runs") as file:
        columns = [file[n][...] for n in ("key", "status", "failure_time", "seconds", "attempts", "finished")]
        reasons = file["reason"].asstr()[...]
    rows = {}
    for position, (key, status, failure_time, seconds, attempts, finished) in enumerate(zip(*columns, strict=True)):
        if status != Status.PENDING:
            name = key.decode()
            rows[name] = Row(
                name,
                int(status),
                str(reasons[position]),
                float(failure_time),
                float(seconds),
                int(attempts),
                float(finished),
                source,
                position,
            )
    return rows


def read_keys(path: Path) -> list[str]:
    """Read the keys of the runs in a file."""
    with opened_hdf5(path, "runs") as file:
        return [k.decode() for k in file["key"][...]]


def read_header(path: Path) -> tuple[Header, np.ndarray, np.ndarray]:
    """Read the common data of a file and its design."""
    with opened_hdf5(path, "runs of a Campaign") as file:
        _refuse_later_layout(path, int(file.attrs["schema"]))
        plain = json.loads(file.attrs["records"])
        records = tuple(
            record_from_plain(p, values[: int(samples)])
            for p, values, samples in zip(plain, file["excitation"][...], file["samples"][...], strict=True)
        )
        channels = tuple(str(c) for c in file["channel"].asstr()[...])
        space = ParameterSpace.from_plain(json.loads(file.attrs["space"]))
        header = Header(json.loads(file.attrs["identity"]), space, records, channels)
        return header, file["theta"][...], file["record_of_run"][...].astype(int)


def _refuse_later_layout(path: Path, layout: int) -> None:
    """Refuse a file of a later layout version, which this version of structid would misread."""
    if layout > SCHEMA:
        raise InputError(f"{path}", f"runs in layout {layout}", f"layout {SCHEMA} or earlier", "Update structid.")


def record_from_plain(plain: dict[str, Any], values: Float[np.ndarray, "time *motion"]) -> Excitation:
    """Rebuild an excitation from its description and its samples."""
    if "parts" in plain:
        parts = [record_from_plain(p, v) for p, v in zip(plain["parts"], values.T, strict=True)]
        return CombinedExcitation(parts, plain["name"])
    settings = {k: v for k, v in plain.items() if k != "kind"}
    return _KINDS[plain["kind"]](values=values, **settings)


def as_runs(
    header: Header,
    theta: Float[np.ndarray, "run parameter"],
    record_of_run: Int[np.ndarray, " run"],
    rows: Sequence[Row],
    values: Any,
    path: Path | None,
) -> Runs:
    """Make `Runs` from rows."""
    return Runs(
        Design(theta, header.space),
        header.records,
        header.channels,
        values,
        np.array([row.status for row in rows], dtype=np.int8),
        record_of_run,
        tuple(row.reason for row in rows),
        np.array([row.failure_time for row in rows]),
        np.array([row.seconds for row in rows]),
        np.array([row.attempts for row in rows]),
        np.array([row.finished for row in rows], dtype=float),
        path,
    )
