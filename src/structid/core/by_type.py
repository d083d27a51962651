"""Objects of different types, each found by its type."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

T = TypeVar("T")


class ByType:
    """At most one object of each type: ``results.get(Fragility)`` is a `Fragility` or None.

    The type is that under which an object was put in, so that a subclass may stand for its base.
    """

    def __init__(self, content: Mapping[type, Any] | None = None) -> None:
        self._content = {kind: value for kind, value in (content or {}).items() if value is not None}

    def get(self, kind: type[T]) -> T | None:
        """The object of a type; None where there is none."""
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
        """Return the same objects with another one of this type; None leaves it out."""
        return ByType({**self._content, kind: value})
