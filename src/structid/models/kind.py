"""What a kind of model says of itself, so that a study file can name it and nobody else needs to know its name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from structid.models.face import Model
from structid.probability.space import ParameterSpace


@dataclass(frozen=True, eq=False)
class ModelRequest:
    """What a study asks of a model.

    Parameters
    ----------
    given : mapping of str to object
        What its table says, quantities in SI; keys that were left out are not there.
    space : ParameterSpace
        The unknown parameters.
    free : tuple of str
        Those of them, and of the derived ones, that the model knows.
    channels : tuple of str
        What somebody measures or wants.
    folder : Path
        Where relative paths start.
    """

    given: Mapping[str, Any]
    space: ParameterSpace
    free: tuple[str, ...]
    channels: tuple[str, ...]
    folder: Path


@dataclass(frozen=True, eq=False)
class ModelKind:
    """One kind of model: its word, its keys in a study file, and what builds it.

    Parameters
    ----------
    word : str
        ``type`` in a study file.
    keys : mapping of str to tuple
        Keys of its table: the type as pydantic reads it, and the default, ``...`` for a key that must be there.
    build : callable
        Makes the model of a `ModelRequest`.
    parameters : callable, optional
        Names of the parameters that the model knows, by what its table says. None for a solver, which takes any.
    parameter_unit : callable, optional
        SI unit of a parameter by name, by what the table says and by the names of all unknown ones; None where it is not known.
    check : callable, optional
        Looks at the raw table before its keys are read, and returns it.
    named_in_messages : tuple of str
        Parameters that a message lists, best of one spring or storey alone; all that it knows when empty.
    note : str
        What such a list ends with.
    """

    word: str
    keys: Mapping[str, tuple[Any, Any]]
    build: Callable[[ModelRequest], Model]
    parameters: Callable[[Mapping[str, Any]], Collection[str]] | None = None
    parameter_unit: Callable[[str, Mapping[str, Any], Collection[str]], str | None] | None = None
    check: Callable[[Any], Any] | None = None
    named_in_messages: tuple[str, ...] = ()
    note: str = ""

    @property
    def is_a_solver(self) -> bool:
        """Whether it runs somebody's solver, whose parameters and channels are the study's affair."""
        return self.parameters is None
