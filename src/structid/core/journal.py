"""An append-only journal file that survives a kill at any moment, and safe reading and writing of files."""

from __future__ import annotations

import fcntl
import io
import json
import os
import shutil
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.errors import InputError, StoreMismatchError, undamaged

_MAGIC = b"structid-journal-1\n"
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_FRAME = struct.Struct("<QI")  # payload length, CRC-32


class Journal:
    """A file of entries, each a dictionary of arrays. A completely written entry is never lost.

    `append` returns after the entry is on disk (``fsync``). Each entry has its length and checksum, so that an incomplete last
    entry is recognised; the next entry overwrites it.
    """

    def __init__(self, path: str | os.PathLike[str], identity: Mapping[str, Any]) -> None:
        self.path = Path(path)
        self.identity = dict(identity)
        self._size = self._size_on_disk()  # a larger or smaller file has another writer
        # The first entry creates the file, so a campaign without runs leaves none.
        self._end = self._check() if self._size > 0 else 0

    def _create(self) -> None:
        header = _MAGIC + _frame(json.dumps(self.identity, sort_keys=True).encode())
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # Write, then rename: a journal either has a complete header or does not exist.
        write_then_rename(self.path, header)
        self._end = self._size = len(header)

    def _size_on_disk(self) -> int:
        return self.path.stat().st_size if self.path.exists() else 0

    def _check(self) -> int:
        with self.path.open("rb") as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                raise InputError(
                    f"store {self.path}",
                    "this file is not a structid journal",
                    "a journal or no file",
                    "Name another store; this file has not been changed.",
                )
            header = _read_frame(file)
            if header is None:
                raise InputError(
                    f"store {self.path}",
                    "its header is damaged",
                    "a complete journal",
                    "Move the file away and start again.",
                )
            compare_identity(self.path, json.loads(header), self.identity)
            end = file.tell()
            while _read_frame(file) is not None:
                end = file.tell()
            self._keep_what_follows(file, end)
        return end

    def _keep_what_follows(self, file: io.BufferedReader, end: int) -> None:
        """Copy a journal that is damaged before its last entry, since intact entries may follow the damage."""
        file.seek(end)
        head = file.read(_FRAME.size)
        if len(head) < _FRAME.size:
            return
        length, _ = _FRAME.unpack(head)
        if length == 0 or length >= self.path.stat().st_size - end - _FRAME.size:
            return
        copy = self.path.with_name(self.path.name + ".damaged")
        shutil.copyfile(self.path, copy)
        warnings.warn(
            f"{self.path} is damaged at byte {end}; later entries are not read. A copy of the file is kept as {copy}.",
            stacklevel=4,
        )

    @property
    def size(self) -> int:
        """Size on disk [byte]."""
        return self._end

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Journal:
        """Open a journal for reading, whatever its identity."""
        return cls(path, _identity_of(Path(path)))

    @staticmethod
    def entries_after(path: str | os.PathLike[str], place: int) -> tuple[list[dict[str, np.ndarray]], int]:
        """Read the entries written after a position; another process may still be writing."""
        entries = []
        with Path(path).open("rb") as file:
            file.seek(place or len(_MAGIC))
            if place == 0 and _read_frame(file) is None:
                return [], 0
            end = file.tell()
            while (payload := _read_frame(file)) is not None:
                with np.load(io.BytesIO(payload), allow_pickle=False) as entry:
                    entries.append({name: entry[name] for name in entry.files})
                end = file.tell()
        return entries, end

    def remove(self) -> None:
        """Delete the file; the next entry starts a new one."""
        self.path.unlink(missing_ok=True)
        self._end = self._size = 0

    def append(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Write one entry; it is on disk when the method returns. A second writer of the file is an `InputError`."""
        buffer = io.BytesIO()
        np.savez(buffer, **{k: np.asarray(v) for k, v in arrays.items()})  # type: ignore[arg-type]
        payload = buffer.getbuffer()  # no copy: a block of draws is tens of megabytes
        head = _frame_head(payload)
        self._refuse_second_writer(self._size_on_disk())
        if self._end == 0:
            self._create()
        try:
            with self.path.open("r+b") as file:
                with suppress(OSError):  # a file system without locks
                    fcntl.flock(file, fcntl.LOCK_EX)
                self._refuse_second_writer(os.fstat(file.fileno()).st_size)
                file.truncate(self._end)
                file.seek(self._end)
                file.write(head)
                file.write(payload)
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            self._size = self._size_on_disk()  # a part of the entry may be there
            raise
        self._end += len(head) + len(payload)
        self._size = self._end

    def _refuse_second_writer(self, size: int) -> None:
        """Refuse to overwrite what another process has written since this one last wrote or read."""
        if size != self._size:
            raise InputError(
                f"store {self.path}",
                "another process has written to it",
                "one writer at a time",
                "Wait until it ends, then run this one again: it continues from the store.",
            )

    def __iter__(self) -> Iterator[dict[str, np.ndarray]]:
        if self._end == 0:
            return
        with self.path.open("rb") as file:
            file.seek(len(_MAGIC))
            _read_frame(file)
            while file.tell() < self._end:
                payload = _read_frame(file)
                if payload is None:
                    return
                with np.load(io.BytesIO(payload), allow_pickle=False) as entry:
                    yield {name: entry[name] for name in entry.files}


def _identity_of(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        header = _read_frame(file) if file.read(len(_MAGIC)) == _MAGIC else None
    return {} if header is None else json.loads(header)


def write_then_rename(path: Path, content: bytes) -> None:
    """Write a file completely or not at all."""
    temporary = path.with_name(path.name + ".partial")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


READERS = {1: "0.1", 2: "0.1", 3: "0.1", 4: "0.2"}
"""Version of structid that wrote each layout and can read it."""


def refuse_other_layout(path: Path, found: Any, expected: Any) -> None:
    """Refuse a store of another layout, and name the version that can read it."""
    if found == expected or expected is None:
        return
    version = READERS.get(1 if found is None else found)
    reader = "a later structid" if version is None else f"structid {version}"
    raise StoreMismatchError(
        f"store {path}",
        f"it was written by another version of structid (layout {1 if found is None else found})",
        f"a store of layout {expected}",
        f"It can be read with {reader}. To start again, name another store or folder. This one is unchanged.",
    )


CURES = {
    "model": "To keep the runs of an earlier solver version, use --adopt (in Python: adopt=True).",
    "engine": "The engines agree except in the last digits. To continue with JAX: STRUCTID_ENGINE=jax. To keep runs: --adopt.",
}
"""Remedy for a difference in each of these keys, if no other keys of the identities differ."""


@contextmanager
def opened_hdf5(path: str | os.PathLike[str], content: str) -> Iterator[Any]:
    """Open an HDF5 file; distinguish a damaged file from a file of another format."""
    import h5py

    given = Path(path)
    if given.is_file() and given.stat().st_size > 0:
        with given.open("rb") as raw:
            if raw.read(len(HDF5_SIGNATURE)) != HDF5_SIGNATURE:
                cure = "Name another file. This one is unchanged."
                raise InputError(
                    f"{path}", "it is not an HDF5 file", f"a file in which structid has stored {content}", cure
                )
    with undamaged(path, content), h5py.File(given, "r") as file:
        yield file


def compare_identity(path: Path, found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Refuse a store with a different identity, and report the differences."""
    refuse_other_layout(path, found.get("schema"), expected.get("schema"))
    differing = differences(found, expected)
    if differing:
        what = "; ".join(f"{k} is {found.get(k)!r} in the store, {expected.get(k)!r} here" for k in differing)
        cure = "".join(f" {CURES[key]}" for key in differing) if set(differing) <= CURES.keys() else ""
        raise StoreMismatchError(
            f"store {path}",
            f"it belongs to another study: {what}",
            "the store of this study, or a new file",
            f"Name another store or folder, or move this one away. It is unchanged.{cure}",
        )


def differences(found: Mapping[str, Any], expected: Mapping[str, Any]) -> list[str]:
    """List the keys in which two identities differ."""
    plain = json.loads(json.dumps(dict(expected)))
    return sorted(k for k in {*found, *plain} if found.get(k) != plain.get(k))


def _frame(payload: bytes) -> bytes:
    return _frame_head(payload) + payload


def _frame_head(payload: bytes | memoryview) -> bytes:
    return _FRAME.pack(len(payload), zlib.crc32(payload))


def _read_frame(file: io.BufferedReader) -> bytes | None:
    head = file.read(_FRAME.size)
    if len(head) < _FRAME.size:
        return None
    length, checksum = _FRAME.unpack(head)
    here = file.tell()
    # A power failure may leave zeros, or an incomplete length.
    if length == 0 or length > file.seek(0, os.SEEK_END) - here:
        return None
    file.seek(here)
    payload = file.read(length)
    return payload if len(payload) == length and zlib.crc32(payload) == checksum else None
