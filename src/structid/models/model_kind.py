"""Description of a kind of model that a study file can name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from structid.models.base import Model
from structid.probability.space import ParameterSpace


@dataclass(frozen=True, eq=False)
class ModelRequest:
    """Requirements of a study for a model."""

    given: Mapping[str, Any]  # content of the model's table, quantities in SI, without omitted keys
    space: ParameterSpace  # unknown parameters
    free: tuple[str, ...]  # parameters of the model, including derived parameters
    channels: tuple[str, ...]  # channels that are measured or requested
    folder: Path  # base of relative paths


@dataclass(frozen=True, eq=False)
class ModelKind:
    """One kind of model: its name and keys in a study file, and the function that builds it.

    Parameters
    ----------
    word : str
        Value of ``type`` in a study file.
    keys : mapping of str to tuple
        Keys of the model's table: the type for pydantic, and the default, or ``...`` for a required key.
    build : callable
        Function that makes the model from a `ModelRequest`.
    parameters : callable, optional
        Function that returns the parameter names of the model from its table. None for a solver, which allows any name.
    parameter_unit : callable, optional
        Function that returns the SI unit of a parameter, or None, from its name, the table and the names of all unknowns.
    check : callable, optional
        Function that checks the raw table before its keys are read, and returns it.
    named_in_messages : tuple of str
        Parameters that a message lists, preferably of a single spring or storey; all parameters if empty.
    note : str
        Text at the end of such a list.
    moved_channel : str
        A channel for building the model under imposed displacements; empty if displacements cannot be imposed.

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
        """Whether the model runs an external solver, whose parameters and channels the study defines."""
        return self.parameters is None
