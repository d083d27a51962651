"""External draws in any form: arrays, tables, ArviZ objects and files."""

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
from structid.data_files.file_content import FileContent
from structid.inference.sampling_result import SamplingResult

Draws = SamplingResult | Mapping[str, Any] | np.ndarray | str | os.PathLike[str] | Any
"""Draws in SI: an array ([chain,] draw, parameter), named columns, an ArviZ object, a file, or a `SamplingResult`."""

WHERE = "certify(draws)"
CHAIN_AND_DRAW = ("chain", "draw")

FEWEST, FEWEST_FOR_EACH = 100, 20
"""Minimum number of draws, in total and per parameter, for sufficiently accurate moments."""

ACROSS = 0.1
"""Correlation of neighbouring chains, beyond three standard errors, above which the supposed chains are taken for the steps of an
ensemble. The correlation must also exceed that of successive draws."""


def draws_of(
    draws: Draws, names: tuple[str, ...], units: Mapping[str, str] | None = None
) -> Float[np.ndarray, "chain draw parameter"]:
    """Extract draws of the parameters from any container.

    Named columns are taken by name, unnamed columns by position. Further columns, even of strings, are ignored.
    """
    if isinstance(draws, SamplingResult):
        draws_by_name = _by_name({n: draws.draws[:, :, i] for i, n in enumerate(draws.names)}, names)
    elif isinstance(draws, (str, os.PathLike)):
        draws_by_name = _of_file(Path(draws), names, units or {})
    elif hasattr(draws, "posterior"):  # InferenceData, DataTree
        draws_by_name = _of_dataset(draws.posterior, names, units or {})
    elif hasattr(draws, "data_vars"):  # xarray.Dataset
        draws_by_name = _of_dataset(draws, names, units or {})
    elif hasattr(draws, "columns") and hasattr(draws, "to_numpy"):  # DataFrame of pandas or polars
        draws_by_name = _of_table(draws, names)
    elif isinstance(draws, np.ndarray) and draws.dtype.names:
        draws_by_name = _by_name({name: draws[name] for name in draws.dtype.names}, names)
    elif isinstance(draws, Mapping):
        draws_by_name = _by_name({str(name): values for name, values in draws.items()}, names)
    else:
        draws_by_name = _columns(real_array(WHERE, draws, "draws, as an array of numbers"), names)
    return _checked(draws_by_name, names)


def density_with(draws: Draws) -> Callable[[np.ndarray], np.ndarray] | np.ndarray | None:
    """Return the log density stored with the draws."""
    if isinstance(draws, SamplingResult):
        return draws.target.log_density
    if not isinstance(draws, (str, os.PathLike)) or Path(draws).suffix.lower() != ".nc":
        return None
    import xarray

    try:
        with xarray.open_dataset(draws, group="sample_stats") as statistics:
            own_name = "lp" if statistics.attrs.get("inference_library") == "structid" else ""
            available = next((name for name in ("log_density", own_name) if name in statistics), None)
            return None if available is None else np.asarray(statistics[available].transpose("chain", "draw").values)
    except (OSError, KeyError, ValueError):
        return None  # no such group; `draws_of` reports what is wrong with the file


def _of_file(path: Path, names: tuple[str, ...], units: Mapping[str, str]) -> np.ndarray:
    """Read draws (chain, draw, parameter) from the group `posterior` of a netCDF file, or from a table."""
    if not path.is_file():
        raise InputError(WHERE, f"no file {path}", "a netCDF file with the group 'posterior', or a CSV file")
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
    """Read a CSV file with a heading line, # comment lines, and commas, semicolons, tabs or spaces between columns."""
    import pandas

    lines = [line for line in FileContent(path).lines if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise InputError(WHERE, f"{path}: {len(lines)} lines", "a heading line, and a line for each draw")
    separator = next((sign for sign in ";\t," if sign in lines[0]), r"\s+")
    decimal = "," if separator in (";", "\t", r"\s+") and "," in lines[1] and "." not in lines[1] else "."
    text = io.StringIO("\n".join(lines))
    try:
        return pandas.read_csv(
            text, sep=separator, decimal=decimal, skipinitialspace=True, index_col=False, engine="python"
        )
    except ValueError as problem:  # pandas raises these for parsing errors
        raise InputError(
            WHERE, f"{path}: {problem}", "a title line, and the same number of values in every line"
        ) from None


def _check_cells(path: Path, table: Any, names: tuple[str, ...]) -> None:
    """Refuse a table without a heading line, or with a parameter's cell that is not a number."""
    import pandas

    heads = [str(name).strip() for name in table.columns]
    if all(pandas.notna(pandas.to_numeric(head, errors="coerce")) for head in heads):
        raise InputError(WHERE, f"{path}: numbers in the first line", f"a heading line: {', '.join(names)}")
    for head, name in zip(heads, table.columns, strict=True):
        if head not in names or pandas.api.types.is_numeric_dtype(table[name]):
            continue
        wrong = table[name][pandas.to_numeric(table[name], errors="coerce").isna() & table[name].notna()]
        if len(wrong):
            raise InputError(WHERE, f"{path}, draw {wrong.index[0] + 1}: {name} is '{wrong.iloc[0]}'", "numbers")


def _of_table(table: Any, names: tuple[str, ...]) -> np.ndarray:
    """Extract draws from a DataFrame; columns or index levels named chain and draw identify the chains."""
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
    if len({len(row) for row in rows}) > 1:
        return np.asarray(flat[None])
    if "draw" in columns and "draw" not in names:
        draw = np.asarray(columns["draw"].to_numpy())
        rows = [row[np.argsort(draw[row], kind="stable")] for row in rows]
    return np.stack([flat[row] for row in rows])


def _of_dataset(dataset: Any, names: tuple[str, ...], units: Mapping[str, str]) -> np.ndarray:
    """Extract draws from an xarray.Dataset; elements of array variables are named as in ArviZ, b[0], b[1]."""
    if "sample" in dataset.dims:
        # As returned by az.extract: chain and draw in one dimension, with a joint index if all draws are present.
        index = dataset.indexes.get("sample")
        both = set(CHAIN_AND_DRAW) <= set(getattr(index, "names", ())) and index.is_unique
        if both and len(index) == np.prod([index.get_level_values(name).nunique() for name in CHAIN_AND_DRAW]):
            dataset = dataset.unstack("sample")
        else:
            dataset = dataset.drop_vars(("sample", *CHAIN_AND_DRAW), errors="ignore")
            dataset = dataset.rename(sample="draw").expand_dims("chain")
    columns: dict[str, Any] = {}
    for name, variable in dataset.data_vars.items():
        missing = [dimension for dimension in CHAIN_AND_DRAW if dimension not in variable.dims]
        if missing:
            continue
        ordered = variable.transpose(*CHAIN_AND_DRAW, ...)
        places = list(np.ndindex(ordered.shape[2:]))
        for position in places:
            column_name = str(name) if ordered.ndim == 2 else f"{name}[{', '.join(map(str, position))}]"
            if column_name in names:
                values = real_array(f"{WHERE}: {column_name}", ordered.values[(slice(None), slice(None), *position)])
                columns[column_name] = values * _factor(column_name, variable.attrs, units)
            else:
                columns[column_name] = None
    return _by_name(columns, names)


def _factor(name: str, attributes: Mapping[str, Any], units: Mapping[str, str]) -> float:
    """SI value of one unit of a variable, from its attribute ``unit``, or ``units`` as in the CF conventions."""
    declared = {key: str(attributes[key]) for key in ("unit", "units") if str(attributes.get(key, "")).strip()}
    where = f"{WHERE}: {name}"
    factors = {
        key: factor_of(unit, units[name], where) if units.get(name) else factor(unit) for key, unit in declared.items()
    }
    if len(set(factors.values())) > 1:
        came = " and ".join(f"{key} = '{unit}'" for key, unit in declared.items())
        raise InputError(where, came, "one unit", "Remove the attribute that is wrong.")
    return next(iter(factors.values()), 1.0)


def _by_name(columns: Mapping[str, Any], names: tuple[str, ...]) -> np.ndarray:
    """Stack the columns of the parameters into an array (chain, draw, parameter)."""
    missing = [name for name in names if name not in columns]
    if missing:
        raise InputError(
            WHERE,
            f"draws of {', '.join(columns) or 'nothing'}",
            f"draws of all parameters of the posterior, with the same names: {', '.join(names)}",
            f"Add draws of {', '.join(missing)}. Error-model parameters, such as sigma2, are also needed.",
        )
    columns_taken = [np.atleast_2d(real_array(f"{WHERE}: {name}", columns[name], "numbers")) for name in names]
    if len({values.shape for values in columns_taken}) > 1:
        shapes = ", ".join(f"{name} {values.shape}" for name, values in zip(names, columns_taken, strict=True))
        raise InputError(WHERE, f"columns of different shapes: {shapes}", "one shape: (draw,) or (chain, draw)")
    return np.stack(columns_taken, axis=-1)


def _columns(array: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Validate an array (draw, parameter) or (chain, draw, parameter)."""
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
            f"{array.shape[0]} chains of {array.shape[1]} draws, with a correlation of {across:.2f} between neighbouring "
            f"chains and of {along:.2f} between successive draws",
            "(chain, draw, parameter); for independent draws, one array (draw, parameter)",
            "emcee's get_chain() returns (step, walker, parameter): give chain.swapaxes(0, 1), and its log densities transposed.",
        )
    return array


def _correlation_of_neighbours(array: np.ndarray, axis: int) -> float:
    """Correlation of neighbours along an axis of (chain, draw, parameter), averaged over the parameters."""
    x = np.moveaxis(array - array.mean(axis=(0, 1)), axis, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.mean(x[1:] * x[:-1], axis=(0, 1)) / np.mean(x**2, axis=(0, 1)) if len(x) > 1 else np.zeros(1)
    return float(np.nanmean(correlation)) if np.isfinite(correlation).any() else 0.0


def _checked(draws: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """Refuse too few draws, values that are not finite, and constant parameters."""
    count, fewest = draws.shape[0] * draws.shape[1], max(FEWEST, FEWEST_FOR_EACH * len(names))
    if count < fewest:
        raise InputError(
            WHERE,
            f"{count} draws",
            f"{fewest} or more for {len(names)} parameters, a few thousand recommended",
            "Take more draws: the certificate concerns their means and standard deviations.",
        )
    if not np.isfinite(draws).all():
        raise InputError(WHERE, f"{int((~np.isfinite(draws)).sum())} values that are not finite", "numbers")
    flat = draws.reshape(-1, len(names))
    fixed = [name for name, spread in zip(names, np.ptp(flat, axis=0), strict=True) if spread == 0.0]
    if fixed:
        raise InputError(WHERE, f"draws with a constant {', '.join(fixed)}", "draws that vary")
    return draws
