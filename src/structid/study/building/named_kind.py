"""What every table of a study file that names a kind has in common."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Protocol, TypeVar

from structid.core.errors import InputError


class Named(Protocol):
    """A kind of model, surrogate, law or sampler."""

    @property
    def word(self) -> str:
        """What a study file calls it."""
        ...


AnyKind = TypeVar("AnyKind", bound=Named)


def kind_named(word: str, kinds: Iterable[AnyKind]) -> AnyKind:
    """Find a kind by its word; the schema has checked that there is one."""
    return next(kind for kind in kinds if kind.word == word)


def check_keys(table: str, word: str, given: Iterable[str], known: Collection[str]) -> None:
    """Refuse keys that belong to another kind: the schema lets all of them into the table."""
    for key in given:
        if key not in known:
            raise InputError(f"key '{table}.{key}'", f"a key that {word} does not know", ", ".join(known))
