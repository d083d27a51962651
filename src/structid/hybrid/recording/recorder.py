"""The recording of a test in progress: its rows survive a killed process and a full disk, and do not delay the test.

The test loop copies each row into mapped memory (the *tail*), which belongs to the kernel and survives the end of this
process. Every `BLOCK` seconds, a thread moves the rows to the journal on disk. There are two tails: one is filled while
the other is written. Their space is reserved before the test begins. A full disk is therefore detected before anything
moves; a disk that fills up later ends the test without loss of data.
"""

from __future__ import annotations

import json
import mmap
import os
import struct
import threading
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError, StructidError
from structid.core.journal import Journal

BLOCK = 0.075
"""Time between two blocks [s]."""
TAIL_ROOM = 8 * 2**20
"""Minimum size of a tail [byte]."""
ROWS_IN_TAIL = 256
"""Minimum number of rows in a tail."""
SCHEMA = "hybrid-test-1"
JOURNAL = ".journal"
"""Suffix of a journal, appended to the name of its store."""
_ENTRY = struct.Struct("<QQI")  # 1 + number of the row, bytes, CRC-32


class RecordingError(StructidError):
    """A recording cannot continue; the test ends, and earlier data are kept."""


def journal_of(store: Path) -> Path:
    """Return the path of the journal of a store."""
    return store.with_name(store.name + JOURNAL)


def tails_of(store: Path) -> tuple[Path, Path]:
    """Return the paths of the tails of a store."""
    return store.with_name(store.name + ".tail0"), store.with_name(store.name + ".tail1")


class _Tail:
    """Rows in mapped memory, one after another; a row is valid if its checksum is right."""

    def __init__(self, path: Path, room: int) -> None:
        self.path, self.end, self.rows = path, 0, []  # type: ignore[var-annotated]
        with path.open("w+b") as file:
            os.posix_fallocate(file.fileno(), 0, room)
            self.memory = mmap.mmap(file.fileno(), room)

    def fits(self, row: bytes) -> bool:
        return self.end + _ENTRY.size + len(row) <= len(self.memory)

    def add(self, number: int, row: bytes) -> None:
        body = self.end + _ENTRY.size
        self.memory[body : body + len(row)] = row
        # The head is written last: a row with a head is complete.
        self.memory[self.end : body] = _ENTRY.pack(number + 1, len(row), zlib.crc32(row))
        self.end = body + len(row)
        self.rows.append((number, row))

    def clear(self) -> None:
        self.memory[: _ENTRY.size] = bytes(_ENTRY.size)
        self.end, self.rows = 0, []

    def close(self) -> None:
        self.memory.close()


def _rows_left_in(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the valid rows of a tail, even if its process was killed."""
    if not path.exists():
        return
    content, position = path.read_bytes(), 0
    while position + _ENTRY.size <= len(content):
        number, length, checksum = _ENTRY.unpack_from(content, position)
        position += _ENTRY.size
        row = content[position : position + length]
        if number == 0 or len(row) < length or zlib.crc32(row) != checksum:
            return
        yield number - 1, row
        position += length


def _rows_in_tails(store: Path) -> dict[int, np.ndarray]:
    """Return the rows of both tails, by row number.

    Rows move from a tail to the journal. The journal is read after the tails, so that no moving row is missed.
    """
    left = (entry for tail in tails_of(store) for entry in _rows_left_in(tail))
    return {number: np.frombuffer(row, dtype="<f8") for number, row in left}


def _added_to(rows: dict[int, np.ndarray], entries: Iterable[Mapping[str, np.ndarray]]) -> dict[str, Any]:
    """Add the rows of a journal's entries; return the description of the test, empty if no entry contains it."""
    about: dict[str, Any] = {}
    for entry in entries:
        if "about" in entry:
            about = json.loads(entry["about"].tobytes())
        else:
            rows |= dict(enumerate(entry["rows"], start=int(entry["first"])))
    return about


class Recorder:
    """Recorder of rows of equal length, in files next to a store, until the store itself is written."""

    def __init__(self, store: Path, about: Mapping[str, Any], width: int) -> None:
        for path in (store, journal_of(store)):
            if path.exists():
                raise InputError(
                    f"store {store}",
                    f"{path.name} already exists",
                    "a file that does not exist yet",
                    "A recording is never overwritten. Choose another file, or move this file away.",
                )
        self.store, self.width, self.failed = store, width, ""
        store.parent.mkdir(parents=True, exist_ok=True)
        self._journal = Journal(journal_of(store), {"schema": SCHEMA})
        room = max(TAIL_ROOM, ROWS_IN_TAIL * (8 * width + _ENTRY.size))
        try:
            self._journal.append({"about": np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)})
            self._tails = [_Tail(path, room) for path in tails_of(store)]
        except OSError as error:
            for path in (*tails_of(store), journal_of(store)):
                path.unlink(missing_ok=True)
            raise InputError(
                f"store {store}",
                f"the recording cannot start: {error.strerror}",
                f"a disk with {2 * room / 2**20:.0f} MB of free space",
                "Free some space and start again. Nothing has moved.",
            ) from None
        self._count = 0
        self._lock, self._due, self._closing = threading.Lock(), threading.Event(), False
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add(self, row: Float[np.ndarray, " width"]) -> None:
        """Record a row, which then survives a kill of this process and, one block later, a crash of the machine."""
        content = np.ascontiguousarray(row, dtype="<f8").tobytes()
        with self._lock:
            tail = self._tails[0]
            if not tail.fits(content):
                raise RecordingError("The recording cannot keep up with the test: the disk is too slow.")
            tail.add(self._count, content)
            self._count += 1
        if self.failed:
            raise RecordingError(
                f"The recording cannot continue: {self.failed}. All finished steps are in files next to {self.store}."
            )

    def _write(self) -> None:
        """Move blocks to the journal until the recording is closed."""
        while not self._closing:
            self._due.wait(BLOCK)
            self._take()

    def _take(self) -> None:
        with self._lock:
            full = self._tails[0]
            if not full.rows or self.failed:
                return
            self._tails.reverse()
        try:
            rows = np.stack([np.frombuffer(row, dtype="<f8") for _, row in full.rows])
            self._journal.append({"first": np.array(full.rows[0][0]), "rows": rows})
        except OSError as error:
            # The rows of this tail stay there, and the other tail accepts new rows.
            self.failed = error.strerror or str(error)
            return
        full.clear()

    def close(self) -> None:
        """Write the remaining rows, and end the thread."""
        self._closing = True
        self._due.set()
        self._thread.join()
        self._take()
        for tail in self._tails:
            tail.close()

    def remove(self) -> None:
        """Delete the recording after its contents are in the store."""
        self._journal.remove()
        for path in tails_of(self.store):
            path.unlink(missing_ok=True)


class Following:
    """Reader of the rows of a test that another process records; it does not affect that process."""

    def __init__(self, store: Path) -> None:
        self.store, self.about, self.count, self._place = store, {}, 0, 0  # type: ignore[var-annotated]

    def new_rows(self) -> Float[np.ndarray, "row width"]:
        """Read the new rows."""
        try:
            rows = _rows_in_tails(self.store)
            entries, self._place = Journal.entries_after(journal_of(self.store), self._place)
        except FileNotFoundError:
            return np.zeros((0, 0))
        self.about = _added_to(rows, entries) or self.about
        result = []
        while self.count in rows:
            result.append(rows[self.count])
            self.count += 1
        return np.stack(result) if result else np.zeros((0, 0))


def recorded(store: Path) -> tuple[dict[str, Any], np.ndarray]:
    """Read a recording, even of a process that was killed."""
    path = journal_of(store)
    if not path.exists():
        raise InputError(f"store {store}", "there is no recording", "the store of a hybrid test")
    rows = _rows_in_tails(store)
    about = _added_to(rows, Journal.read(path))
    if sorted(rows) != list(range(len(rows))):
        missing = next(k for k in range(len(rows)) if k not in rows)
        raise InputError(f"store {store}", f"row {missing} is missing", "a complete recording")
    return about, np.stack([rows[k] for k in range(len(rows))]) if rows else np.zeros((0, 0))
