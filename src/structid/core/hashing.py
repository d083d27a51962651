"""Content hashes of arrays, settings and functions, which identify the study that a store belongs to."""

from __future__ import annotations

import functools
import hashlib
import json
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

LARGEST_DESCRIPTION = 100_000
"""Largest number of objects that a description contains in full; beyond it, repeated objects appear only by number.

Objects that refer to one another by many paths, such as a model of another library, would otherwise be described once per path.
Smaller descriptions contain every object in full, so that hashes in earlier stores stay valid.
"""


@dataclass(frozen=True, eq=False)
class Pieces:
    """An array in pieces along its first axis; its hash is that of the whole array."""

    arrays: Sequence[np.ndarray]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the numbers, common to all pieces."""
        return self.arrays[0].dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole array."""
        return (sum(len(piece) for piece in self.arrays), *self.arrays[0].shape[1:])


def digest(*parts: Any) -> str:
    """Short content hash of arrays and JSON-compatible values."""
    sha = hashlib.sha256()
    for part in parts:
        if isinstance(part, (np.ndarray, Pieces)):
            sha.update(str((part.dtype.str, part.shape)).encode())
            for piece in part.arrays if isinstance(part, Pieces) else [part]:
                sha.update(_bytes_of(piece))
        else:
            sha.update(json.dumps(part, sort_keys=True, default=repr).encode())
    return sha.hexdigest()[:16]


def _bytes_of(array: np.ndarray) -> Any:
    """Bytes of an array in C order; without a copy of a contiguous array, which may be all draws of a run."""
    contiguous = np.ascontiguousarray(array)
    return contiguous.tobytes() if contiguous.dtype.hasobject else contiguous.reshape(-1).view(np.uint8)


def function_identity(function: Any) -> str:
    """Hash of everything that can be determined about a function's behaviour.

    The hash covers the code, defaults and closure of the function, and everything it uses from its own module: functions,
    classes, numbers, strings and arrays. Objects imported from other modules enter the hash by name only.
    """
    try:
        return digest(_described(function, _Walk()))
    except _TooManyObjectsError:
        return digest(_described(function, _Walk(numbers={})))


class _TooManyObjectsError(Exception):
    """A description that contains every object in full is too large."""


@dataclass(frozen=True)
class _Walk:
    """State of a description: the path to the current object, and all objects described so far."""

    path: frozenset[int] = frozenset()  # identities of the objects that contain it, which prevent an endless recursion
    visited: list[Any] = field(default_factory=list)  # all objects so far, kept alive so that an identity stays theirs
    numbers: dict[int, int] | None = None  # number of each described object; None while every object is spelled out

    def into(self, value: Any) -> _Walk:
        """The path from the outermost object to the parts of an object."""
        if self.numbers is not None:
            self.numbers[id(value)] = len(self.visited)
        elif len(self.visited) >= LARGEST_DESCRIPTION:
            raise _TooManyObjectsError
        self.visited.append(value)
        return replace(self, path=self.path | {id(value)})


def _described(value: Any, seen: _Walk) -> Any:
    """Represent a value in JSON-compatible form."""
    if isinstance(value, (str, int, float, bool, type(None))):
        return value
    if isinstance(value, (bytes, complex)):
        return repr(value)
    if id(value) in seen.path:
        return getattr(value, "__qualname__", type(value).__qualname__)
    if seen.numbers is not None and id(value) in seen.numbers:
        return ["object", seen.numbers[id(value)]]
    seen = seen.into(value)
    if isinstance(value, types.FunctionType):
        return _described_function(value, seen)
    if isinstance(value, types.MethodType):
        return [_described(value.__func__, seen), _described(value.__self__, seen)]
    if isinstance(value, type):
        members = {k: v for k, v in vars(value).items() if k not in _NOT_BEHAVIOUR}
        return [value.__qualname__, {k: _described(v, seen) for k, v in sorted(members.items())}]
    if isinstance(value, types.CodeType):
        constants = [_described(c, seen) for c in value.co_consts]
        return [value.co_code.hex(), constants, list(value.co_names), list(value.co_varnames)]
    if isinstance(value, functools.partial):
        return [_described(part, seen) for part in (value.func, value.args, value.keywords)]
    if isinstance(value, (list, tuple)):
        return [_described(v, seen) for v in value]
    if isinstance(value, (set, frozenset)):
        return sorted((_described(v, seen) for v in value), key=repr)
    if isinstance(value, Mapping):
        return {str(k): _described(v, seen) for k, v in value.items()}
    if hasattr(value, "__array__"):  # a NumPy or JAX array, or a table
        return digest(np.asarray(value))
    if isinstance(value, types.ModuleType):
        return value.__name__
    return _described_object(value, seen)


_NOT_BEHAVIOUR = (
    "__module__",
    "__doc__",
    "__dict__",
    "__weakref__",
    "__qualname__",
    "__firstlineno__",
    "__static_attributes__",
)
"""Members of a class that do not affect its behaviour."""


def _described_object(value: Any, seen: _Walk) -> Any:
    """Represent an object by its string attribute ``identity`` if it has one, otherwise by its type and content."""
    identity = getattr(value, "identity", None)
    if isinstance(identity, str):
        return identity
    if isinstance(value, property):
        return [_described(f, seen) for f in (value.fget, value.fset)]
    inner = next((getattr(value, n) for n in ("__wrapped__", "py_func", "__func__") if hasattr(value, n)), None)
    if inner is not None:  # a decorated function
        return [type(value).__qualname__, _described(inner, seen)]
    if isinstance(value, (types.BuiltinFunctionType, types.MethodDescriptorType, np.ufunc)):
        return getattr(value, "__qualname__", getattr(value, "__name__", ""))
    state = dict(getattr(value, "__dict__", {}))
    for kind in type(value).__mro__:
        slots = getattr(kind, "__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if name not in _NOT_BEHAVIOUR and hasattr(value, name):
                state[name] = getattr(value, name)
    # A cached property is stored only after its first use, and it contains no additional information.
    state = {k: v for k, v in state.items() if not isinstance(getattr(type(value), k, None), functools.cached_property)}
    described = {k: _described(v, seen) for k, v in sorted(state.items())}
    return [_described(type(value), seen) if "__call__" in vars(type(value)) else type(value).__qualname__, described]


def _described_function(function: types.FunctionType, seen: _Walk) -> Any:
    home = function.__globals__
    used = {name: home[name] for name in sorted(_names_in(function.__code__)) if name in home}
    local = {name: v for name, v in used.items() if getattr(v, "__module__", home["__name__"]) == home["__name__"]}
    foreign = {name: getattr(v, "__qualname__", type(v).__qualname__) for name, v in used.items() if name not in local}
    closure = [_described(cell.cell_contents, seen) for cell in function.__closure__ or ()]
    defaults = [_described(v, seen) for v in (function.__defaults__ or ())]
    keywords = {k: _described(v, seen) for k, v in (function.__kwdefaults__ or {}).items()}
    globals_used = {name: _described(v, seen) for name, v in local.items()}
    return [_described(function.__code__, seen), closure, defaults, keywords, globals_used, foreign]


def _names_in(code: types.CodeType) -> set[str]:
    """Global names used by a code object and the functions inside it."""
    inner = [_names_in(c) for c in code.co_consts if isinstance(c, types.CodeType)]
    return set(code.co_names).union(*inner)
