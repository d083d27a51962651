"""Earlier public names, kept for one version with a warning."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, TypeVar, cast

T = TypeVar("T", bound=Callable[..., Any])


def warn_of(old: str, new: str, stacklevel: int = 3) -> None:
    """Warn that the next version removes a name."""
    warnings.warn(
        f"{old} is now called {new}; the next version removes {old}.", DeprecationWarning, stacklevel=stacklevel
    )


def renamed_argument(**new_names: str) -> Callable[[T], T]:
    """Accept the earlier names of arguments of a function or class, as in ``@renamed_argument(law="error_model")``."""

    def decorated(function: T) -> T:
        if isinstance(function, type):
            setattr(function, "__init__", decorated(getattr(function, "__init__")))  # noqa: B009, B010, as mypy wants it
            return function

        name = function.__qualname__.removesuffix(".__init__")

        @functools.wraps(function)
        def called(*arguments: Any, **named: Any) -> Any:
            for old, new in new_names.items():
                if old in named:
                    warn_of(f"{name}({old}=…)", f"{name}({new}=…)")
                    named[new] = named.pop(old)
            return function(*arguments, **named)

        return cast(T, called)

    return decorated


def renamed_attribute(old: str, new: str) -> property:
    """Read an attribute under an earlier name."""

    def attribute(self: Any) -> Any:
        warn_of(f"{type(self).__name__}.{old}", f"{type(self).__name__}.{new}")
        return getattr(self, new)

    attribute.__doc__ = f"Earlier name of `{new}`."
    return property(attribute)
