"""Surrogates in HDF5 files: arrays and plain words, nothing that runs when it is read."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from structid.errors import InputError
from structid.probability.space import ParameterSpace
from structid.surrogates.face import Fit, Surrogate

if TYPE_CHECKING:
    from structid.surrogates.validation import Validation

SCHEMA = 1
"""Version of the layout."""


def save(surrogate: Surrogate, path: str | os.PathLike[str]) -> Path:
    """Write a surrogate, whole or not at all.

    Parameters
    ----------
    surrogate : Surrogate
        The surrogate, with its validation if it has one.
    path : path-like
        The file; one that is there is replaced.

    Returns
    -------
    Path
        The file written.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(target.name + ".partial")
    plain, arrays = surrogate.to_plain()
    fit = {f.name: getattr(surrogate.fitted, f.name) for f in dataclasses.fields(Fit)}
    fit |= {"space": surrogate.space.to_plain(), "low": fit["low"].tolist(), "high": fit["high"].tolist()}
    with h5py.File(partial, "w") as file:
        file.attrs["schema"] = SCHEMA
        file.attrs["content"] = "structid surrogate"
        file.attrs["fit"] = json.dumps(fit, default=str)
        file.attrs["plain"] = json.dumps(plain)
        _write_arrays(file.create_group("arrays"), arrays)
        if surrogate.validation is not None:
            _write_validation(file.create_group("validation"), surrogate.validation)
    partial.replace(target)
    return target


def load_surrogate(path: str | os.PathLike[str]) -> Surrogate:
    """Read a surrogate that `Surrogate.save` wrote.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    Surrogate
        It predicts what it did when it was saved, to the last bit on the same machine.

    Raises
    ------
    InputError
        If the file is none, or of a later version.
    """
    where = str(path)
    if not Path(path).is_file():
        raise InputError(where, "no such file", "a file that Surrogate.save wrote")
    try:
        file = h5py.File(path, "r")
    except OSError as cause:
        raise InputError(where, "a file that is not HDF5", "a file that Surrogate.save wrote") from cause
    with file:
        if file.attrs.get("content") != "structid surrogate":
            raise InputError(where, "an HDF5 file of something else", "a file that Surrogate.save wrote")
        if int(file.attrs["schema"]) > SCHEMA:
            raise InputError(where, f"layout {file.attrs['schema']}", f"{SCHEMA} or earlier", "Update structid.")
        said = json.loads(file.attrs["fit"])
        plain = json.loads(file.attrs["plain"])
        arrays = _read_arrays(file["arrays"])
        validation = _read_validation(file["validation"]) if "validation" in file else None
    said |= {
        "space": ParameterSpace.from_plain(said["space"]),
        "low": np.array(said["low"]),
        "high": np.array(said["high"]),
        "channels": tuple(said["channels"]),
        "seen": tuple(said["seen"]),
    }
    surrogate = _maker(said["kind"])(Fit(**said), plain, arrays)
    surrogate.validation = validation
    return surrogate


def _maker(kind: str) -> Callable[[Fit, dict[str, Any], dict[str, np.ndarray]], Surrogate]:
    from structid.surrogates.narx.parametric_narx import ParametricNARX
    from structid.surrogates.pod.response_space import ResponseSpaceSurrogate

    return (ResponseSpaceSurrogate if kind.startswith("POD") else ParametricNARX).from_plain


def _write_arrays(group: h5py.Group, arrays: dict[str, np.ndarray]) -> None:
    for name, array in arrays.items():
        group.create_dataset(name, data=array)


def _read_arrays(group: h5py.Group) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            found[name] = item[()]

    group.visititems(visit)
    return found


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
    from structid.surrogates.validation import Validation

    said = {name: item[()] for name, item in group.items()}
    true, predicted = said["histories"]
    return Validation(
        tuple(c.decode() for c in said["channels"]),
        said["errors"],
        said["peaks"],
        said["predicted_peaks"],
        float(said["coverage"]),
        int(said["outside"]),
        int(said["left_out"]),
        tuple(int(i) for i in said["shown"]),  # type: ignore[arg-type]
        (true, predicted, float(group.attrs["dt"])),
        tuple(said["clouds"]),
    )
