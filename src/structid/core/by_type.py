"""Objects of different types, each found by its type."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

T = TypeVar("T")


class ByType:
    """At most one object of each type: ``results.get(Fragility)`` is a `Fragility` or None.

    An object is stored under a given type, so a subclass can be stored under its base class.
    """

    def __init__(self, content: Mapping[type, Any] | None = None) -> None:
        self._content = {kind: value for kind, value in (content or {}).items() if value is not None}

    def get(self, kind: type[T]) -> T | None:
        """Return the object of a type, or None if there is none."""
        return self._content.get(kind)

    def __getitem__(self, kind: type[T]) -> T:
        value: T = self._content[kind]
        return value

    def __contains__(self, kind: type) -> bool:
        return kind in self._content

    def __iter__(self) -> Iterator[Any]:
        return iter(self._content.values())

    def __or__(self, others: ByType) -> ByType:
        return ByType(self._content | others._content)

    def having(self, kind: type[T], value: T | None) -> ByType:
        """Return a copy in which the object of this type is replaced; None removes it."""
        return ByType({**self._content, kind: value})
