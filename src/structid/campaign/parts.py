"""The folder with the parts of a store: file names, a lock against a second writer, and messages for disk errors."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from structid.core.errors import InputError, StoreError


def parts_of(path: Path) -> Path:
    """Return the folder of a store's parts."""
    return path.with_name(path.name + ".parts")


def segments_of(path: Path) -> list[Path]:
    """Return the sealed segments of a store, oldest first."""
    return sorted(parts_of(path).glob("segment-*.h5"))


def next_segment(path: Path) -> Path:
    """Name the next segment of a store.

    The name is always new, even if a killed campaign has left segments behind.
    """
    last = max((int(p.stem.partition("-")[2]) for p in segments_of(path)), default=0)
    return parts_of(path) / f"segment-{last + 1:06d}.h5"


def run_files_of(path: Path) -> list[Path]:
    """Return the HDF5 files of a store that exist: the final file and the segments, oldest first."""
    return [p for p in (path, *segments_of(path)) if p.exists()]


def lock(folder: Path, path: Path) -> int | None:
    """Lock a folder against a second writer. The operating system releases the lock when this process ends for any reason."""
    # The lock is a separate file opened for writing, since network file systems support no other lock.
    handle = os.open(folder / "lock", os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise InputError(
            f"store {path}",
            "another process is running this campaign",
            "one writer at a time",
            "Wait until it ends, or stop it.",
        ) from None
    except OSError:  # a file system without locks
        os.close(handle)
        return None
    try:
        same = os.path.samestat(os.fstat(handle), (folder / "lock").stat())
    except FileNotFoundError:
        same = False
    if not same:  # the previous owner has just finished and has removed the file
        os.close(handle)
        folder.mkdir(parents=True, exist_ok=True)
        return lock(folder, path)
    return handle


@contextlib.contextmanager
def disk_errors_explained(path: Path) -> Iterator[None]:
    """Explain a disk error and its effect on the campaign."""
    try:
        yield
    except OSError as problem:
        full = problem.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        what, cure = ("the disk is full", "Free some space") if full else ("it cannot be written", "Correct this")
        raise StoreError(
            f"{path}: {what} ({problem.strerror}). All runs stored so far are safe. {cure}, then run the same campaign again: "
            "it continues with the remaining runs."
        ) from problem
