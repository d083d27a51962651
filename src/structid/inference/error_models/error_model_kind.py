"""The description of an error model, by which a study file can name it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

SQUARED = "squared channel"
"""Placeholder for the square of the channel's SI unit."""


@dataclass(frozen=True, eq=False)
class ErrorModelKind:
    """One error model: its name and its keys in a study file.

    Parameters
    ----------
    error_model : callable
        The class, or a function that builds the error model from the keys.
    word : str
        Value of ``kind`` in a study file.
    quantities : mapping of str to str
        Keys whose value is a number or a prior, with their SI unit or `SQUARED`.
    switches : mapping of str to tuple
        Other keys, with their pydantic type and their default.

    Examples
    --------
    >>> from structid.inference.error_models.error_model_kind import SQUARED, ErrorModelKind
    >>> from structid.inference.error_models.independent import IID
    >>> ErrorModelKind(IID, "white_noise", {"variance": SQUARED}, {}).word
    'white_noise'
    """

    error_model: Callable[..., Any]
    word: str
    quantities: Mapping[str, str]
    switches: Mapping[str, tuple[Any, Any]] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[str, ...]:
        """All keys of the error model."""
        return (*self.quantities, *self.switches)
