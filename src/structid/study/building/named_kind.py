"""Shared functions for tables that select a kind of model, surrogate, error model or sampler."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Protocol, TypeVar

from structid.core.errors import InputError


class Named(Protocol):
    """A kind of model, surrogate, error model or sampler."""

    @property
    def word(self) -> str:
        """Name of the kind in a study file."""
        ...


AnyKind = TypeVar("AnyKind", bound=Named)


def kind_named(word: str, kinds: Iterable[AnyKind]) -> AnyKind:
    """Find a kind by name; the schema has already checked that it exists."""
    return next(kind for kind in kinds if kind.word == word)


def check_keys(table: str, word: str, given: Iterable[str], known: Collection[str]) -> None:
    """Reject keys of another kind, which the schema accepts in the table."""
    for key in given:
        if key not in known:
            raise InputError(f"key '{table}.{key}'", f"a key that {word} does not have", ", ".join(known))
