"""Validation of the arguments of public functions: unknown names, strings for numbers, masked or complex arrays, …."""

from __future__ import annotations

import functools
import inspect
import math
import numbers
import re
import types
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from structid.core.errors import InputError, suggestion

T = TypeVar("T", bound=Callable[..., Any])

NUMBERS = {"float", "int"}
"""Annotations of an argument that is a number."""

ARRAYS = re.compile(r"(Sequence|tuple|list)\[(float|int|np\.ndarray)[^|]*\]|np\.ndarray|ArrayLike")
"""Annotations of an argument that is an array or a sequence of numbers."""

KINDS = {
    "ParameterSpace": ("marginals", "a structid.ParameterSpace"),
    "Model": ("simulate", "a model such as structid.BoucWen or structid.CallableModel"),
    "Target": ("log_density", "a structid.Posterior or structid.LogDensity"),
    "Posterior": ("observations", "a structid.Posterior"),
    "Excitation": ("duration", "a structid.GroundMotion, ForceHistory or DisplacementHistory"),
    "Observation": ("check_new", "a structid.Observation"),
    "ErrorModel": ("added", "an error model such as structid.AR1()"),
    "Sampler": ("ensembles", "a sampler such as structid.SMC()"),
    "SurrogateSettings": ("fit", "settings of a surrogate such as structid.PODKriging()"),
    "Limits": ("confidence_of", "a structid.Limits such as Limits(mean=0.05)"),
    "Plan": ("exploration_sampler", "a structid.Plan such as Plan(true_runs=300)"),
    "Runs": ("design", "a structid.Runs, the result of a Campaign"),
}
"""For each annotation: an attribute that identifies the objects, and a description of a valid argument."""

INSTEAD_OF_A_NUMBER: dict[str, tuple[Callable[[Any], bool], str]] = {
    "Marginal": (lambda value: hasattr(value, "quantile"), "a prior such as Normal(1.0, 0.1)"),
    "Mapping": (lambda value: isinstance(value, Mapping), "a dictionary by channel"),
}
"""For each annotation allowed instead of a number: a test that recognises the value, and its description."""


# --- numbers and arrays ---------------------------------------------------------------------------------------------


def real_number(where: str, value: Any, allowed: str = "a number", cure: str = "") -> Any:
    """Convert a number of any library to a Python number; refuse all other values."""
    if value is None or isinstance(value, (bool, int)) or _is_jax(value):
        return value
    if isinstance(value, float):
        number: Any = float(value)  # NumPy numbers, too
    elif value is np.ma.masked:
        raise InputError(where, "a masked value", allowed, cure)
    elif unit := unit_of(value):
        raise InputError(where, f"a quantity in {unit}", allowed, "Give the plain number, in the documented unit.")
    elif isinstance(value, (np.generic, np.ndarray)) and np.ndim(value) == 0:
        array = real_array(where, value, allowed)
        number = array.item() if np.asarray(value).dtype.kind == "f" else np.asarray(value).item()
    elif isinstance(value, numbers.Real) or type(value).__name__ == "Decimal":
        number = float(value)
    else:
        raise InputError(where, in_words(value), allowed, cure)
    if isinstance(number, float) and math.isnan(number):
        raise InputError(where, "nan, which is not a number", allowed, cure)
    return number


def real_array(where: str, value: Any, allowed: str = "an array of numbers") -> np.ndarray:
    """Convert an array-like to an array of real numbers; refuse values that the conversion would change."""
    if masked := _masked_values(value):
        cure = "Fill the masked values, or remove them."
        raise InputError(where, f"{masked} masked value{'s' if masked > 1 else ''}", f"{allowed}, none masked", cure)
    if unit := unit_of(value):
        cure = "Convert them to the documented unit, and give plain numbers."
        raise InputError(where, f"quantities in {unit}", allowed, cure)
    array = _as_array(where, value, allowed)
    match array.dtype.kind:
        case "b" | "i" | "u" | "f":
            return array.astype(np.float64, copy=False)
        case "c" if not np.any(array.imag):
            return array.real.astype(np.float64)
        case "c":
            cure = "Give the real part or the absolute value."
            raise InputError(where, "complex numbers", f"{allowed}, all of them real", cure)
        case "O":
            return _of_objects(where, array, allowed)
        case "U" | "S" | "T":
            cure = "Convert the strings to numbers first, as in values.astype(float)."
            raise InputError(where, f"strings such as {str(array.ravel()[0])!r}", allowed, cure)
        case "V":
            names = ", ".join(array.dtype.names or ())
            raise InputError(where, f"a structured array with the fields {names}", allowed, "Give one of the fields.")
        case _:
            raise InputError(where, f"values of the type {array.dtype}", allowed)


def real_arrays(where: str, value: Any) -> Any:
    """Convert an argument that may be one array or a sequence of arrays."""
    if isinstance(value, np.ndarray) and not isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "fiub":
        return value
    if isinstance(value, (list, tuple)):
        if any(isinstance(one, (np.ndarray, list, tuple)) or hasattr(one, "__array__") for one in value):
            return type(value)(real_arrays(where, one) for one in value) if type(value) in (list, tuple) else value
        for one in value:
            if isinstance(one, (str, bytes, complex)) or one is np.ma.masked:
                real_number(where, one, "numbers")
        return value
    if isinstance(value, np.ndarray) or _is_pandas(value) or unit_of(value):
        return real_array(where, value)
    return value


def unit_of(value: Any) -> str:
    """Return the unit of a pint, astropy or unyt quantity, so that its numbers are not mistaken for SI values."""
    for unit, number in (("units", "magnitude"), ("unit", "value"), ("units", "value")):
        if hasattr(value, unit) and hasattr(value, number) and not isinstance(value, type):
            return str(getattr(value, unit)) or "no unit"
    return ""


def in_words(value: Any) -> str:
    """Describe a value in words, with an article."""
    if isinstance(value, str):
        return f"the string '{value}'"
    if isinstance(value, complex):
        return f"the complex number {value}"
    name = {"ndarray": "array", "Marginal": "prior"}.get(type(value).__name__, type(value).__name__)
    return f"{'an' if name[0] in 'AEIOaeio' else 'a'} {name}"


def _is_jax(value: Any) -> bool:
    return type(value).__module__.split(".")[0] in ("jax", "jaxlib")


def _is_pandas(value: Any) -> bool:
    return type(value).__module__.split(".")[0] == "pandas" and hasattr(value, "to_numpy")


def _masked_values(value: Any) -> int:
    """Count the masked values of an array or of a list of arrays."""
    if isinstance(value, np.ma.MaskedArray):
        return int(np.count_nonzero(np.ma.getmaskarray(value)))
    if isinstance(value, (list, tuple)):
        return sum(_masked_values(one) for one in value)
    return 0


def _as_array(where: str, value: Any, allowed: str) -> np.ndarray:
    if _is_pandas(value):
        # Missing values of nullable types become NaN.
        kinds = [str(kind) for kind in np.atleast_1d(value.dtypes)]
        if not any(kind in ("object", "category") or "string" in kind or kind == "str" for kind in kinds):
            try:
                return np.asarray(value.to_numpy(dtype=np.float64, na_value=np.nan))
            except (TypeError, ValueError):
                pass
        return np.asarray(value.to_numpy())
    try:
        return np.asarray(value)
    except (ValueError, TypeError) as problem:
        raise InputError(where, f"no array ({problem})", allowed, "Make all rows equally long.") from None


def _of_objects(where: str, array: np.ndarray, allowed: str) -> np.ndarray:
    """Convert an array of Python objects, such as fractions, decimals or integers beyond 64 bits."""
    flat = [real_number(f"{where}, value {index}", one, allowed) for index, one in enumerate(array.ravel())]
    if any(one is None for one in flat):
        missing = next(i for i, one in enumerate(flat) if one is None)
        raise InputError(f"{where}, value {missing}", "None", allowed, "Fill or remove missing values.")
    return np.array(flat, dtype=np.float64).reshape(array.shape)


# --- names ----------------------------------------------------------------------------------------------------------

NAME = re.compile(r"[^\W\d](?:[\w .+-]*[\w.+-])?(?:\[\w+(?:, \w+)*\])?")
"""Pattern of names that every output accepts: tables, pages, figures, file names, netCDF, HDF5.

A name starts with a letter or _ and has no character with a special meaning in an output. ArviZ indices may follow: ``b[0]``.
"""

COORDINATES = ("chain", "draw", "ensemble")
"""Axis names in the netCDF files, which no variable may use."""


def check_name(where: str, name: Any, reserved: Sequence[str] = ()) -> str:
    """Refuse a name that is invalid in some output format."""
    allowed = "a letter first, then letters, digits, _, ., + or -, such as 'stiffness_1'"
    if not isinstance(name, str) or not NAME.fullmatch(name):
        came = in_words(name) if not isinstance(name, str) else f"the name '{name}'" if name else "an empty name"
        raise InputError(
            where, came, allowed, "Choose another name: other characters have a special meaning in files and tables."
        )
    if name in reserved:
        raise InputError(
            where, f"the name '{name}'", f"a name other than {', '.join(reserved)}, which are axes of the draws"
        )
    return name


# --- arguments ------------------------------------------------------------------------------------------------------


def check_arguments(what: T) -> T:
    """Decorate a class or function so that it checks its arguments against their annotations."""
    if not isinstance(what, type):
        return cast(T, _checked(what, what.__qualname__))
    setattr(what, "__init__", _checked(getattr(what, "__init__"), what.__qualname__))  # noqa: B009, B010, as mypy wants it
    for name, method in vars(what).copy().items():
        if not name.startswith("_") and isinstance(method, (classmethod, staticmethod)):
            setattr(what, name, type(method)(_checked(method.__func__, method.__func__.__qualname__)))
        elif not name.startswith("_") and inspect.isfunction(method):
            setattr(what, name, _checked(method, method.__qualname__))
    return what


class _Check(NamedTuple):
    """The check of one argument, derived from its annotation."""

    number: str  # description of the allowed numbers; empty where no number is allowed
    others: tuple[str, ...]  # allowed keys of `INSTEAD_OF_A_NUMBER`
    open: bool  # whether other types are allowed, strings included
    array: bool  # whether an array of numbers is allowed
    kinds: tuple[str, ...]  # allowed keys of `KINDS`; empty if other types are allowed
    several: bool  # whether a sequence of these kinds is allowed

    @classmethod
    def of(cls, annotation: str) -> _Check:
        """Derive the check from an annotation such as ``"float | Marginal | None"``."""
        words = [word for word in _union(annotation) if word != "None"]
        others = tuple(name for name in INSTEAD_OF_A_NUMBER if any(word.split("[")[0] == name for word in words))
        allowed = " or ".join(["a number", *(INSTEAD_OF_A_NUMBER[name][1] for name in others)])
        arrays = [word for word in words if ARRAYS.fullmatch(word)]
        rest = [word for word in words if word not in (*NUMBERS, *arrays) and word.split("[")[0] not in others]
        single = [re.sub(r"^Sequence\[(\w+)\]$", r"\1", word) for word in words]
        only_kinds = bool(single) and set(single) <= KINDS.keys()
        return cls(
            allowed if NUMBERS & set(words) else "",
            others,
            bool(rest),
            bool(arrays),
            tuple(single) if only_kinds else (),
            only_kinds and single != words,
        )

    def refuses_nothing(self) -> bool:
        """Whether the check accepts every value."""
        return not (self.number or self.array or self.kinds)

    def applied(self, where: str, called: str, value: Any) -> Any:
        """Return the value, with numbers and arrays of other libraries converted."""
        if value is None:
            return None
        if self.kinds:
            _refuse_another_kind(where, value, self.kinds, self.several)
            return value
        if self.number and not any(INSTEAD_OF_A_NUMBER[name][0](value) for name in self.others):
            array = self.array and not isinstance(value, str) and isinstance(value, (np.ndarray, Sequence))
            if not array and not (self.open and not _is_number(value)):
                cure = f"Write it without quotes. help({called}) names the unit." if isinstance(value, str) else ""
                return real_number(where, value, self.number, cure)
        return real_arrays(where, value) if self.array else value


def _spelt_out(annotation: Any, function: Callable[..., Any]) -> str:
    """Return an annotation as a string, and expand aliases of unions such as ``Storeys``."""
    meant = getattr(function, "__globals__", {}).get(str(annotation))
    union = str(meant) if isinstance(meant, types.UnionType) else str(annotation)
    return union.replace("collections.abc.", "").replace("numpy.", "np.")


def _union(annotation: str) -> list[str]:
    """Split a union into its members; unions inside brackets stay whole."""
    words, depth = [""], 0
    for sign in annotation:
        depth += (sign == "[") - (sign == "]")
        if sign == "|" and depth == 0:
            words.append("")
        else:
            words[-1] += sign
    return [word.strip() for word in words]


def _is_number(value: Any) -> bool:
    """Whether `real_number` processes a value, that is, converts or refuses it."""
    if isinstance(value, (np.ndarray, np.generic)):
        return np.ndim(value) == 0 and np.asarray(value).dtype.kind not in "USO"
    return isinstance(value, numbers.Number) or value is np.ma.masked or bool(unit_of(value))


def _checked(function: Callable[..., Any], called: str) -> Callable[..., Any]:
    every = inspect.signature(function).parameters
    parameters = {name: p for name, p in every.items() if name not in ("self", "cls")}
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    names = [
        name
        for name, p in parameters.items()
        if not name.startswith("_") and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    ]
    checks = {name: _Check.of(_spelt_out(p.annotation, function)) for name, p in parameters.items()}
    checks = {name: check for name, check in checks.items() if not check.refuses_nothing()}
    in_order = tuple(every)
    by_position = [p for p in every.values() if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    unlimited = any(p.kind is p.VAR_POSITIONAL for p in every.values())
    needed = [
        name
        for name, p in parameters.items()
        if p.default is p.empty and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    ]

    def check(name: str, value: Any) -> Any:
        return checks[name].applied(f"{called}({name})", called, value) if name in checks else value

    @functools.wraps(function)
    def checked(*arguments: Any, **named: Any) -> Any:
        for name in named:
            if not open_ended and name not in parameters:
                cure = suggestion(name, names)
                raise InputError(f"{called}({name})", "this argument does not exist", ", ".join(names) or "none", cure)
        if len(arguments) > len(by_position) and not unlimited:
            few = len(by_position) - sum(name in every for name in ("self", "cls"))
            extra = len(arguments) - len(by_position)
            raise InputError(
                called,
                f"{few + extra} arguments without a name",
                f"at most {few} without a name",
                f"Name the others: {', '.join(names[few:])}.",
            )
        placed = [check(name, value) for name, value in zip(in_order, arguments, strict=False)]
        given = {name: check(name, value) for name, value in named.items()}
        missing = [name for name in needed if name not in in_order[: len(arguments)] and name not in named]
        if missing:
            expected = f"{called}({', '.join(needed)}, …)"
            raise InputError(called, f"missing {' and '.join(missing)}", expected, f"See help({called}).")
        return function(*placed, *arguments[len(in_order) :], **given)

    return checked


def _refuse_another_kind(where: str, value: Any, kinds: tuple[str, ...], several: bool) -> None:
    for one in value if several and isinstance(value, (list, tuple)) else [value]:
        if not any(hasattr(one, KINDS[kind][0]) for kind in kinds):
            raise InputError(where, in_words(one), " or ".join(dict.fromkeys(KINDS[kind][1] for kind in kinds)))
