"""Surrogates in HDF5 files with arrays and plain values only; reading a file executes no code from it."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.journal import opened_hdf5
from structid.surrogates.fit import Fit
from structid.surrogates.surrogate_validation import Validation

SCHEMA = 2
"""Version of the layout."""

CONTENT = "structid surrogate"
"""Declared content of the file."""


@dataclasses.dataclass(frozen=True, eq=False)
class StoredSurrogate:
    """Contents of a surrogate file."""

    fit: Fit  # record of the fit
    plain: dict[str, Any]  # JSON-compatible contents
    arrays: dict[str, np.ndarray]
    validation: Validation | None  # result of the last validation


def write(
    path: str | os.PathLike[str],
    fit: Fit,
    plain: dict[str, Any],
    arrays: dict[str, np.ndarray],
    validation: Validation | None,
) -> Path:
    """Write the contents of a surrogate, completely or not at all."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(target.name + ".partial")
    with h5py.File(partial, "w") as file:
        file.attrs["schema"] = SCHEMA
        file.attrs["content"] = CONTENT
        file.attrs["fit"] = json.dumps(fit.to_plain(), default=str)
        file.attrs["plain"] = json.dumps(plain)
        file.attrs["checksum"] = digest(
            file.attrs["fit"], file.attrs["plain"], *(arrays[name] for name in sorted(arrays))
        )
        _write_arrays(file.create_group("arrays"), arrays)
        if validation is not None:
            _write_validation(file.create_group("validation"), validation)
    partial.replace(target)
    return target


def read(path: str | os.PathLike[str]) -> StoredSurrogate:
    """Read a file written by `write`."""
    where = str(path)
    if not Path(path).is_file():
        raise InputError(where, "there is no such file", "a file that Surrogate.save wrote")
    with opened_hdf5(path, "a surrogate") as file:
        if file.attrs.get("content") != CONTENT:
            raise InputError(where, "an HDF5 file without a surrogate", "a file that Surrogate.save wrote")
        layout = int(file.attrs["schema"])
        if layout != SCHEMA:
            cure = "Update structid." if layout > SCHEMA else "Read it with structid 0.1, or fit the surrogate again."
            raise InputError(where, f"a surrogate of layout {layout}", f"layout {SCHEMA}", cure)
        contents = json.loads(file.attrs["fit"])
        plain = json.loads(file.attrs["plain"])
        arrays = _read_arrays(file["arrays"])
        sum_of_content = digest(file.attrs["fit"], file.attrs["plain"], *(arrays[name] for name in sorted(arrays)))
        if file.attrs.get("checksum", sum_of_content) != sum_of_content:
            raise InputError(
                where,
                "the checksum is wrong",
                "an undamaged file that Surrogate.save wrote",
                "Fit the surrogate again.",
            )
        validation = _read_validation(file["validation"]) if "validation" in file else None
    return StoredSurrogate(Fit.from_plain(contents), plain, arrays, validation)


def _write_arrays(group: h5py.Group, arrays: dict[str, np.ndarray]) -> None:
    for name, array in arrays.items():
        group.create_dataset(name, data=array)


def _read_arrays(group: h5py.Group) -> dict[str, np.ndarray]:
    result: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            result[name] = item[()]

    group.visititems(visit)
    return result


def _write_validation(group: h5py.Group, validation: Validation) -> None:
    for field in dataclasses.fields(validation):
        value = getattr(validation, field.name)
        if field.name == "histories":
            value = np.stack(value[:2])
            group.attrs["dt"] = validation.histories[2]
        elif field.name == "clouds":
            value = np.stack(value)
        elif field.name == "channels":
            value = [c.encode() for c in value]
        group.create_dataset(field.name, data=value)


def _read_validation(group: h5py.Group) -> Validation:
    contents = {name: item[()] for name, item in group.items()}
    true, predicted = contents["histories"]
    return Validation(
        tuple(c.decode() for c in contents["channels"]),
        contents["errors"],
        contents["peaks"],
        contents["predicted_peaks"],
        float(contents["coverage"]),
        int(contents["outside"]),
        int(contents["left_out"]),
        tuple(int(i) for i in contents["shown"]),  # type: ignore[arg-type]
        (true, predicted, float(group.attrs["dt"])),
        tuple(contents["clouds"]),
    )
