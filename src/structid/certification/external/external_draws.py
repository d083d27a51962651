"""Draws that another program made, in whichever form they come: arrays, tables, ArviZ."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.units import factor, factor_of
from structid.core.validation import real_array
from structid.ground_motion.record_files import lines_of
from structid.inference.sampling_result import SamplingResult

Draws = SamplingResult | Mapping[str, Any] | np.ndarray | str | os.PathLike[str] | Any
"""An array (draw, parameter) or (chain, draw, parameter) in SI, columns by name, an ArviZ object or file, or our own result."""

WHERE = "certify(draws)"
CHAIN_AND_DRAW = ("chain", "draw")

FEWEST, FEWEST_FOR_EACH = 100, 20
"""Draws of an approximation, and for each of its parameters, with which its moments are known well enough."""

ACROSS = 0.1
"""Correlation of neighbouring chains, beyond three errors of chance, above which they are steps of an ensemble, if successive draws
correlate less."""


def draws_of(
    draws: Draws, names: tuple[str, ...], units: Mapping[str, str] | None = None
) -> Float[np.ndarray, "chain draw parameter"]:
    """Take draws of some parameters from whatever holds them.

    Columns that have names are taken by name, others by position. Columns of other names, text included, are left out.
    """
    if isinstance(draws, SamplingResult):
        found = _by_name({n: draws.draws[:, :, i] for i, n in enumerate(draws.names)}, names)
    elif isinstance(draws, (str, os.PathLike)):
        found = _of_file(Path(draws), names, units or {})
    elif hasattr(draws, "posterior"):  # InferenceData, DataTree
        found = _of_dataset(draws.posterior, names, units or {})
    elif hasattr(draws, "data_vars"):  # xarray.Dataset
        found = _of_dataset(draws, names, units or {})
    elif hasattr(draws, "columns") and hasattr(draws, "to_numpy"):  # DataFrame of pandas or polars
        found = _of_table(draws, names)
    elif isinstance(draws, np.ndarray) and draws.dtype.names:
        found = _by_name({name: draws[name] for name in draws.dtype.names}, names)
    elif isinstance(draws, Mapping):
        found = _by_name({str(name): values for name, values in draws.items()}, names)
    else:
        found = _columns(real_array(WHERE, draws, "draws, as an array of numbers"), names)
    return _checked(found, names)


def density_with(draws: Draws) -> Callable[[np.ndarray], np.ndarray] | np.ndarray | None:
    """Give the log density that comes with draws."""
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


def _of_file(path: Path, names: tuple[str, ...], units: Mapping[str, str]) -> np.ndarray:
    """Draws of the group `posterior` of a netCDF file, or of a table with heads, (chain, draw, parameter)."""
    if not path.is_file():
        raise InputError(WHERE, f"no file {path}", "a netCDF file with the group 'posterior', or a CSV with heads")
    if path.suffix.lower() in (".csv", ".txt", ".tsv", ".dat"):
        table = _text_table(path)
        _check_cells(path, table, names)
        return _of_table(table, names)
    import xarray

    try:
        with xarray.open_dataset(path, group="posterior") as dataset:
            loaded = dataset.load()
    except (OSError, KeyError, ValueError) as error:
        raise InputError(
            WHERE, f"{path}: {error}", "a netCDF file with the group 'posterior' of the ArviZ schema"
        ) from None
    return _of_dataset(loaded, names, units)


def _text_table(path: Path) -> Any:
    """Read a CSV with heads as a DataFrame: commas, semicolons, tabs or spaces between columns, comments after #."""
    import pandas

    lines = [line for line in lines_of(path) if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise InputError(WHERE, f"{path}: {len(lines)} lines", "a line of heads, and a line for each draw")
    separator = next((sign for sign in ";\t," if sign in lines[0]), r"\s+")
    decimal = "," if separator in (";", "\t", r"\s+") and "," in lines[1] and "." not in lines[1] else "."
    text = io.StringIO("\n".join(lines))
    try:
        return pandas.read_csv(
            text, sep=separator, decimal=decimal, skipinitialspace=True, index_col=False, engine="python"
        )
    except ValueError as problem:  # pandas' errors of parsing are such
        raise InputError(WHERE, f"{path}: {problem}", "a line of heads, and as many values in every line") from None


def _check_cells(path: Path, table: Any, names: tuple[str, ...]) -> None:
    """Refuse a table without heads, and name the first cell of a parameter that is no number."""
    import pandas

    heads = [str(name).strip() for name in table.columns]
    if all(pandas.notna(pandas.to_numeric(head, errors="coerce")) for head in heads):
        raise InputError(WHERE, f"{path}: numbers in the first line", f"a line of heads: {', '.join(names)}")
    for head, name in zip(heads, table.columns, strict=True):
        if head not in names or pandas.api.types.is_numeric_dtype(table[name]):
            continue
        wrong = table[name][pandas.to_numeric(table[name], errors="coerce").isna() & table[name].notna()]
        if len(wrong):
            raise InputError(WHERE, f"{path}, draw {wrong.index[0] + 1}: {name} is '{wrong.iloc[0]}'", "numbers")


def _of_table(table: Any, names: tuple[str, ...]) -> np.ndarray:
    """Draws of a DataFrame; those of several chains are told apart by columns, or by an index, called chain and draw."""
    if hasattr(table, "reset_index") and set(CHAIN_AND_DRAW) <= set(getattr(table.index, "names", ())):
        table = table.reset_index(allow_duplicates=True)
    columns = {str(name).strip(): table[name] for name in dict.fromkeys(table.columns)}
    twice = [name for name in names if [str(c).strip() for c in table.columns].count(name) > 1]
    if twice:
        raise InputError(WHERE, f"two columns called {twice[0]}", "one column for each parameter")
    flat = _by_name(columns, names)[0]
    if "chain" not in columns or "chain" in names:
        return np.asarray(flat[None])
    chain = np.asarray(columns["chain"].to_numpy())
    rows = [np.flatnonzero(chain == label) for label in dict.fromkeys(chain.tolist())]
    if len({len(own) for own in rows}) > 1:
        return np.asarray(flat[None])
    if "draw" in columns and "draw" not in names:
        draw = np.asarray(columns["draw"].to_numpy())
        rows = [own[np.argsort(draw[own], kind="stable")] for own in rows]
    return np.stack([flat[own] for own in rows])


def _of_dataset(dataset: Any, names: tuple[str, ...], units: Mapping[str, str]) -> np.ndarray:
    """Draws of an xarray.Dataset; variables with further dimensions are named as ArviZ names them, b[0], b[1]."""
    if "sample" in dataset.dims:
        # As az.extract gives them: chain and draw in one dimension, with an index of the two where all draws are there.
        index = dataset.indexes.get("sample")
        both = set(CHAIN_AND_DRAW) <= set(getattr(index, "names", ())) and index.is_unique
        if both and len(index) == np.prod([index.get_level_values(name).nunique() for name in CHAIN_AND_DRAW]):
            dataset = dataset.unstack("sample")
        else:
            dataset = dataset.drop_vars(("sample", *CHAIN_AND_DRAW), errors="ignore")
            dataset = dataset.rename(sample="draw").expand_dims("chain")
    found: dict[str, Any] = {}
    for name, variable in dataset.data_vars.items():
        missing = [dimension for dimension in CHAIN_AND_DRAW if dimension not in variable.dims]
        if missing:
            continue
        ordered = variable.transpose(*CHAIN_AND_DRAW, ...)
        places = list(np.ndindex(ordered.shape[2:]))
        for place in places:
            own = str(name) if ordered.ndim == 2 else f"{name}[{', '.join(map(str, place))}]"
            if own in names:
                values = real_array(f"{WHERE}: {own}", ordered.values[(slice(None), slice(None), *place)])
                found[own] = values * _factor(own, variable.attrs, units)
            else:
                found[own] = None
    return _by_name(found, names)


def _factor(name: str, attributes: Mapping[str, Any], units: Mapping[str, str]) -> float:
    """SI value of one unit of a variable, which says it in ``unit``, or in ``units`` as the CF conventions have it."""
    said = {key: str(attributes[key]) for key in ("unit", "units") if str(attributes.get(key, "")).strip()}
    where = f"{WHERE}: {name}"
    factors = {
        key: factor_of(unit, units[name], where) if units.get(name) else factor(unit) for key, unit in said.items()
    }
    if len(set(factors.values())) > 1:
        came = " and ".join(f"{key} = '{unit}'" for key, unit in said.items())
        raise InputError(where, came, "one unit", "Remove the attribute that is wrong.")
    return next(iter(factors.values()), 1.0)


def _by_name(columns: Mapping[str, Any], names: tuple[str, ...]) -> np.ndarray:
    """The columns of the parameters, (chain, draw, parameter)."""
    missing = [name for name in names if name not in columns]
    if missing:
        raise InputError(
            WHERE,
            f"draws of {', '.join(columns) or 'nothing'}",
            f"draws of all parameters of the posterior, by the same names: {', '.join(names)}",
            f"There are none of {', '.join(missing)}. Parameters of the errors, such as sigma2, are parameters, too.",
        )
    taken = [np.atleast_2d(real_array(f"{WHERE}: {name}", columns[name], "numbers")) for name in names]
    if len({values.shape for values in taken}) > 1:
        shapes = ", ".join(f"{name} {values.shape}" for name, values in zip(names, taken, strict=True))
        raise InputError(WHERE, f"columns of different shapes: {shapes}", "one shape: (draw,) or (chain, draw)")
    return np.stack(taken, axis=-1)


def _columns(array: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """An array (draw, parameter) or (chain, draw, parameter)."""
    if array.ndim not in (2, 3) or array.shape[-1] != len(names):
        raise InputError(
            WHERE,
            f"an array of shape {array.shape}",
            f"(draw, {len(names)}) or (chain, draw, {len(names)}): a column in SI for each of {', '.join(names)}",
        )
    if array.ndim == 2:
        return array[None]
    along, across = (_correlation_of_neighbours(array, axis) for axis in (1, 0))
    if across > max(along, ACROSS + 3.0 / np.sqrt(array[..., 0].size)):
        raise InputError(
            WHERE,
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
            WHERE,
            f"{count} draws",
            f"{fewest} or more for {len(names)} parameters, best some thousand",
            "Their means and standard deviations are what the certificate is about.",
        )
    if not np.isfinite(draws).all():
        raise InputError(WHERE, f"{int((~np.isfinite(draws)).sum())} values that are not finite", "numbers")
    flat = draws.reshape(-1, len(names))
    fixed = [name for name, spread in zip(names, np.ptp(flat, axis=0), strict=True) if spread == 0.0]
    if fixed:
        raise InputError(WHERE, f"draws that are all the same in {', '.join(fixed)}", "draws of a posterior")
    return draws
