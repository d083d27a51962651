"""Draws on disk: a journal while a sampler runs, one HDF5 file when it has finished."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structid.core.hashing import Pieces, digest
from structid.core.journal import Journal, compare_identity, opened_hdf5

if TYPE_CHECKING:
    import h5py

SCHEMA = 6
"""Version of the file layout and of the sampler moves that continue a stored chain."""


class ChainStore:
    """Blocks of draws that remain if the process is killed: each is on disk before the next begins.

    An HDF5 file may become corrupt if the process is killed while extending it. Blocks therefore go to a checksummed
    journal (``<path>.journal``) and are merged into the HDF5 file by write-then-rename.
    """

    def __init__(self, path: str | os.PathLike[str], identity: Mapping[str, Any]) -> None:
        self.path = Path(path)
        self.identity = {"schema": SCHEMA, **identity}
        self._finished = self._read_finished()
        journal = self.path.with_name(self.path.name + ".journal")
        self._journal = Journal(journal, self.identity)

    def _read_finished(self) -> list[dict[str, np.ndarray]]:
        if not self.path.exists():
            return []
        with opened_hdf5(self.path, "draws of a sampler") as file:
            identity, arrays = file.attrs["identity"], {name: file[name][...] for name in file}
            checksum = _checksum(identity, arrays)
            if file.attrs.get("checksum", checksum) != checksum:  # older files have none
                raise OSError("its content does not match its checksum")
        compare_identity(self.path, json.loads(identity), self.identity)
        ends = np.cumsum(arrays.pop("block_steps"))
        return [
            {name: array[start:end] for name, array in arrays.items()}
            for start, end in zip([0, *ends[:-1]], ends, strict=True)
        ]

    def blocks(self) -> list[dict[str, np.ndarray]]:
        """All blocks on disk, in order."""
        # A kill between the rename and the removal of the journal leaves blocks in both; a last block that was too short
        # for a longer run is written again. The later entry counts.
        blocks = dict(enumerate(self._finished))
        for block in self._journal:
            blocks[int(block.pop("index"))] = block
        return [blocks[i] for i in sorted(blocks)]

    def append(self, index: int, block: Mapping[str, np.ndarray]) -> None:
        """Store one block on disk."""
        self._journal.append({"index": np.array(index), **block})

    def finish(self) -> None:
        """Merge all blocks into the HDF5 file and remove the journal."""
        import h5py

        blocks = self.blocks()
        if any(True for _ in self._journal):
            temporary = self.path.with_name(self.path.name + ".partial")
            with h5py.File(temporary, "w") as file:
                arrays = {name: Pieces([b[name] for b in blocks]) for name in blocks[0]}
                steps = np.array([len(next(iter(b.values()))) for b in blocks])
                arrays["block_steps"] = Pieces([steps])
                file.attrs["identity"] = json.dumps(self.identity, sort_keys=True)
                file.attrs["checksum"] = _checksum(file.attrs["identity"], arrays)
                for name, array in arrays.items():
                    _write_pieces(file, name, array)
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.replace(self.path)
        self._journal.path.unlink(missing_ok=True)


def _write_pieces(file: h5py.File, name: str, array: Pieces) -> None:
    """Write an array piece by piece: joining them would need as much memory once more."""
    dataset = file.create_dataset(name, array.shape, array.dtype, compression="gzip", compression_opts=1)
    first = 0
    for piece in array.arrays:
        dataset[first : first + len(piece)] = piece
        first += len(piece)


def _checksum(identity: str, arrays: Mapping[str, np.ndarray | Pieces]) -> str:
    return digest(identity, *(part for name in sorted(arrays) for part in (name, arrays[name])))
