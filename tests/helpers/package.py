"""What the package holds, found by looking: so that a new implementation of a seam cannot be forgotten by its tests."""

import functools
import importlib
import inspect
import pkgutil

import structid


@functools.cache
def modules():
    """Every module of the package, imported."""
    names = [m.name for m in pkgutil.walk_packages(structid.__path__, "structid.") if "templates" not in m.name]
    return [importlib.import_module(name) for name in names]


def concrete_subclasses(base):
    """Classes of the package that implement a seam and are not abstract themselves."""
    modules()
    found, waiting = set(), [base]
    while waiting:
        for one in waiting.pop().__subclasses__():
            waiting.append(one)
            if one.__module__.startswith("structid.") and not inspect.isabstract(one):
                found.add(one)
    return found
