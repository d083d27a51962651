"""Signatures give the shapes of arrays: here is what compares them with every call of a test run.

`watch` wraps each function and dataclass of the package whose annotations are jaxtyping's, when its file has been imported. The
names in a shape stand for one size in one call. (jaxtyping's own import hook wraps all functions, which doubles the time.)
"""

from __future__ import annotations

import functools
import importlib.abc
import importlib.machinery
import inspect
import re
import sys
import types
import typing

from jaxtyping import jaxtyped

CALLS = 200
"""Calls of a function that are checked; what is wrong shows in the first, and hot functions stay fast."""
SHAPED = re.compile(r"\b(Float|Int|Bool)\[")


def shaped(annotations):
    """Names and texts of annotations that give a shape."""
    return {name: text for name, text in annotations.items() if isinstance(text, str) and SHAPED.search(text)}


def described(value):
    """Type, and for an array its shape and kind of numbers."""
    shape = getattr(value, "shape", None)
    return f"{type(value).__name__}" if shape is None else f"{type(value).__name__} {shape} of {value.dtype}"


def fits(value, hint):
    """Whether a value is of an annotation, which may be a tuple of several."""
    if typing.get_origin(hint) is tuple:
        parts = typing.get_args(hint)
        return len(value) == len(parts) and all(map(fits, value, parts))
    return isinstance(value, hint)


def compare(where, values, hints, texts):
    """Refuse what is not of its shape; None passes, since mypy knows where it may be."""
    for name, value in values.items():
        if name in hints and value is not None and not fits(value, hints[name]):
            raise TypeError(f"{where}, {name}: {described(value)} is not {texts[name]}")


class Checks:
    """Annotations of one function, and how many of its calls are still to be checked."""

    identity = "shape checks"  # all that a hash of the function needs: what it holds changes with the first call

    def __init__(self, function):
        self.texts = shaped(function.__annotations__)
        self.order, self.hints, self.left = list(inspect.signature(function).parameters), {}, CALLS
        self.scope = inspect.unwrap(function).__globals__

    def due(self):
        """Whether this call is checked; all names are there when the function is called."""
        if not self.hints:
            self.hints.update({name: eval(text, self.scope) for name, text in self.texts.items()})
        self.left -= 1
        return self.left >= 0


def checked(function):
    """Compare arguments and results of a function with its annotations."""
    checks = Checks(function)
    if not checks.texts:
        return function

    @functools.wraps(function)
    def called(*arguments, **named):
        if not checks.due():
            return function(*arguments, **named)
        with jaxtyped("context"):
            given = dict(zip(checks.order, arguments, strict=False)) | named
            compare(function.__qualname__, given, checks.hints, checks.texts)
            result = function(*arguments, **named)
            compare(function.__qualname__, {"return": result}, checks.hints, checks.texts)
        return result

    return called


def check_class(kind):
    """Check the methods of a class; that which makes a dataclass has the annotations of its fields."""
    for name, member in list(vars(kind).items()):
        if isinstance(member, types.FunctionType):
            setattr(kind, name, checked(member))
        elif isinstance(member, (classmethod, staticmethod)) and isinstance(member.__func__, types.FunctionType):
            setattr(kind, name, type(member)(checked(member.__func__)))


def check_module(module):
    """Check what a file of the package defines."""
    for name, thing in list(vars(module).items()):
        if getattr(thing, "__module__", None) != module.__name__:
            continue
        if isinstance(thing, types.FunctionType):
            setattr(module, name, checked(thing))
        elif inspect.isclass(thing):
            check_class(thing)


class Watching(importlib.abc.MetaPathFinder):
    """Finds files of the package as Python does, and checks what they define once they are imported."""

    def find_spec(self, name, path, target=None):
        if not name.startswith("structid."):
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def executed(module):
            execute(module)
            check_module(module)

        spec.loader.exec_module = executed
        return spec


def watch():
    """Check everything of the package that is imported from now on."""
    sys.meta_path.insert(0, Watching())
