"""The description of a kind of model, by which a study file can name it without other code knowing its name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from structid.models.base import Model
from structid.probability.space import ParameterSpace


@dataclass(frozen=True, eq=False)
class ModelRequest:
    """What a study requires of a model."""

    given: Mapping[str, Any]  # content of its table, quantities in SI, without omitted keys
    space: ParameterSpace  # unknown parameters
    free: tuple[str, ...]  # parameters, derived ones included, that the model has
    channels: tuple[str, ...]  # channels that are measured or requested
    folder: Path  # base of relative paths


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
        Names of the parameters that the model knows, from its table. None for a solver, which takes any.
    parameter_unit : callable, optional
        SI unit of a parameter, from its name, the table and the names of all unknown parameters; None where it is not known.
    check : callable, optional
        Looks at the raw table before its keys are read, and returns it.
    named_in_messages : tuple of str
        Parameters that a message lists, best those of a single spring or storey. When empty, all that the model knows.
    note : str
        What such a list ends with.
    moved_channel : str
        A channel with which it can be built where displacements are imposed on its structure; empty where none can be.

    Examples
    --------
    >>> from structid.core.keys import quantity
    >>> from structid.models.hysteretic.bouc_wen import BoucWen
    >>> from structid.models.model_kind import ModelKind
    >>> kind = ModelKind(
    ...     word="linear_oscillator",
    ...     keys={"mass": (quantity("kg"), ...), "damping_ratio": (float, 0.05)},
    ...     build=lambda asked: BoucWen(alpha=1.0, free=asked.free, channels=asked.channels, **asked.given),
    ...     parameters=lambda given: ("stiffness", "damping_ratio"),
    ... )
    >>> kind.keys["damping_ratio"]
    (<class 'float'>, 0.05)
    """

    word: str
    keys: Mapping[str, tuple[Any, Any]]
    build: Callable[[ModelRequest], Model]
    parameters: Callable[[Mapping[str, Any]], Collection[str]] | None = None
    parameter_unit: Callable[[str, Mapping[str, Any], Collection[str]], str | None] | None = None
    check: Callable[[Any], Any] | None = None
    named_in_messages: tuple[str, ...] = ()
    note: str = ""
    moved_channel: str = ""

    @property
    def is_a_solver(self) -> bool:
        """Whether it runs an external solver, whose parameters and channels the study defines."""
        return self.parameters is None
