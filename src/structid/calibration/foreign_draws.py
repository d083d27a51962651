"""Draws that another program made, in whichever form they come: arrays, tables, ArviZ."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from structid.errors import InputError
from structid.inference.sampling_result import SamplingResult
from structid.units import factor

Draws = SamplingResult | Mapping[str, Any] | np.ndarray | str | os.PathLike[str] | Any
"""An array (draw, parameter) or (chain, draw, parameter) in SI, columns by name, an ArviZ object or file, or our own result."""

FEWEST, FEWEST_FOR_EACH = 100, 20
"""Draws of an approximation, and for each of its parameters, with which its moments are known well enough."""

ACROSS = 0.1
"""Correlation of neighbouring chains, beyond three errors of chance, above which they are steps of an ensemble, if successive draws
correlate less."""


def draws_of(draws: Draws, names: tuple[str, ...]) -> np.ndarray:
    """Take draws of some parameters from whatever holds them.

    Parameters
    ----------
    draws : SamplingResult, mapping, ndarray, ArviZ object or path
        In SI; a variable of an ArviZ object may have an attribute ``unit`` that says in which other unit it is.
    names : tuple of str
        The parameters, in the order of an array's columns.

    Returns
    -------
    ndarray, shape (chain, draw, parameter)
        In SI; one chain where there are none.

    Raises
    ------
    InputError
        If they are draws of other parameters, too few, not finite, or all the same.
    """
    if isinstance(draws, SamplingResult):
        found = _by_name({n: draws.draws[:, :, i] for i, n in enumerate(draws.names)}, names)
    elif isinstance(draws, (str, os.PathLike)):
        found = _by_name(_of_file(Path(draws)), names)
    elif hasattr(draws, "posterior"):  # InferenceData, DataTree
        found = _by_name(_of_dataset(draws.posterior), names)
    elif hasattr(draws, "data_vars"):  # xarray.Dataset
        found = _by_name(_of_dataset(draws), names)
    elif isinstance(draws, Mapping):
        found = _by_name({str(k): np.asarray(v, dtype=np.float64) for k, v in draws.items()}, names)
    else:
        found = _columns(np.asarray(draws, dtype=np.float64), names)
    return _checked(found, names)


def density_with(draws: Draws) -> Callable[[np.ndarray], np.ndarray] | np.ndarray | None:
    """Give the log density that comes with draws.

    Parameters
    ----------
    draws : SamplingResult, mapping, ndarray, ArviZ object or path
        As in `draws_of`.

    Returns
    -------
    callable, ndarray of shape (chain, draw), or None
        Of a result, its target's; of a netCDF file the variable ``log_density`` of its group ``sample_stats``, or ``lp`` where
        structid wrote the file: elsewhere that is the density of other coordinates. None where there is none.
    """
    if isinstance(draws, SamplingResult):
        return draws.target.log_density
    if not isinstance(draws, (str, os.PathLike)) or Path(draws).suffix.lower() != ".nc":
        return None
    import xarray

    try:
        with xarray.open_dataset(draws, group="sample_stats") as statistics:
            own = "lp" if statistics.attrs.get("inference_library") == "structid" else ""
            known = next((name for name in ("log_density", own) if name in statistics), None)
            return None if known is None else np.asarray(statistics[known].transpose("chain", "draw").values)
    except (OSError, KeyError, ValueError):
        return None  # no such group; what is wrong with the file, `draws_of` says


def _of_file(path: Path) -> dict[str, np.ndarray]:
    """Variables of the group `posterior` of a netCDF file, or of a table with heads."""
    if not path.is_file():
        raise InputError(
            "certify(draws)", f"no file {path}", "a netCDF file with the group 'posterior', or a CSV with heads"
        )
    if path.suffix.lower() in (".csv", ".txt"):
        table = np.genfromtxt(path, names=True, delimiter=",", deletechars="")
        return {name: np.atleast_1d(table[name]) for name in table.dtype.names or ()}
    import xarray

    try:
        with xarray.open_dataset(path, group="posterior") as dataset:
            return _of_dataset(dataset.load())
    except (OSError, KeyError, ValueError) as error:
        raise InputError(
            "certify(draws)", f"{path}: {error}", "a netCDF file with the group 'posterior' of the ArviZ schema"
        ) from None


def _of_dataset(dataset: Any) -> dict[str, np.ndarray]:
    """Variables of an xarray.Dataset; those with further dimensions are named as ArviZ names them, b[0], b[1]."""
    found = {}
    for name, variable in dataset.data_vars.items():
        values = np.asarray(variable.transpose("chain", "draw", ...).values, dtype=np.float64)
        values = values * factor(str(variable.attrs.get("unit", "")))
        if values.ndim == 2:
            found[str(name)] = values
        else:
            for place in np.ndindex(values.shape[2:]):
                found[f"{name}[{', '.join(map(str, place))}]"] = values[(slice(None), slice(None), *place)]
    return found


def _by_name(columns: Mapping[str, np.ndarray], names: tuple[str, ...]) -> np.ndarray:
    """The columns of the parameters, (chain, draw, parameter)."""
    missing = [name for name in names if name not in columns]
    if missing:
        raise InputError(
            "certify(draws)",
            f"draws of {', '.join(columns) or 'nothing'}",
            f"draws of all parameters of the posterior, by the same names: {', '.join(names)}",
            f"There are none of {', '.join(missing)}. Parameters of the errors, such as sigma2, are parameters, too.",
        )
    return np.stack([np.atleast_2d(columns[name]) for name in names], axis=-1)


def _columns(array: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """An array (draw, parameter) or (chain, draw, parameter)."""
    if array.ndim not in (2, 3) or array.shape[-1] != len(names):
        raise InputError(
            "certify(draws)",
            f"an array of shape {array.shape}",
            f"(draw, {len(names)}) or (chain, draw, {len(names)}): a column in SI for each of {', '.join(names)}",
        )
    if array.ndim == 2:
        return array[None]
    along, across = (_correlation_of_neighbours(array, axis) for axis in (1, 0))
    if across > max(along, ACROSS + 3.0 / np.sqrt(array[..., 0].size)):
        raise InputError(
            "certify(draws)",
            f"{array.shape[0]} chains of {array.shape[1]} draws, of which neighbouring chains correlate by {across:.2f} and "
            f"successive draws by {along:.2f}",
            "(chain, draw, parameter); independent draws are one array (draw, parameter)",
            "emcee's get_chain() is (step, walker, parameter): give chain.swapaxes(0, 1), and its log densities transposed.",
        )
    return array


def _correlation_of_neighbours(array: np.ndarray, axis: int) -> float:
    """Correlation of what follows one another along an axis of (chain, draw, parameter), averaged over the parameters."""
    x = np.moveaxis(array - array.mean(axis=(0, 1)), axis, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.mean(x[1:] * x[:-1], axis=(0, 1)) / np.mean(x**2, axis=(0, 1)) if len(x) > 1 else np.zeros(1)
    return float(np.nanmean(correlation)) if np.isfinite(correlation).any() else 0.0


def _checked(draws: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Refuse what no posterior can be judged by."""
    count, fewest = draws.shape[0] * draws.shape[1], max(FEWEST, FEWEST_FOR_EACH * len(names))
    if count < fewest:
        raise InputError(
            "certify(draws)",
            f"{count} draws",
            f"{fewest} or more for {len(names)} parameters, best some thousand",
            "Their means and standard deviations are what the certificate is about.",
        )
    if not np.isfinite(draws).all():
        raise InputError("certify(draws)", f"{int((~np.isfinite(draws)).sum())} values that are not finite", "numbers")
    flat = draws.reshape(-1, len(names))
    fixed = [name for name, spread in zip(names, np.ptp(flat, axis=0), strict=True) if spread == 0.0]
    if fixed:
        raise InputError("certify(draws)", f"draws that are all the same in {', '.join(fixed)}", "draws of a posterior")
    return draws
