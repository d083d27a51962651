"""The model of a study. The free parameters are the parameters that both the model and the parameter space have."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from structid.core.errors import InputError, suggestion, within
from structid.models import model_list
from structid.models.base import Model
from structid.models.model_kind import ModelKind, ModelRequest
from structid.probability.expressions import parse_expression
from structid.probability.space import ParameterSpace
from structid.study.building.named_kind import kind_named
from structid.study.schema.static_tables import ModelTable


def build_model(
    section: ModelTable, space: ParameterSpace, derived: dict[str, str], channels: tuple[str, ...], folder: Path
) -> Model:
    """Build the model of a study."""
    kind = kind_named(section.type, model_list.MODELS)
    given = _given(section)
    if not space.names:
        raise InputError("the file", "no [parameters]", "a prior for one or more parameters of the model")
    if kind.parameters is None:
        return kind.build(ModelRequest(given, space, (), channels, folder))
    parameters = kind.parameters(given)
    _check_parameters(kind, parameters, given, space, derived)
    free = tuple(name for name in space.all_names if name in parameters)
    with within("table 'model'"):
        return kind.build(ModelRequest(given, space, free, channels, folder))


def _given(section: ModelTable) -> dict[str, Any]:
    """Keys of the table that have a value."""
    return {key: value for key, value in section.model_dump(exclude={"type"}).items() if value is not None}


def _check_parameters(
    kind: ModelKind, known: Collection[str], given: dict[str, Any], space: ParameterSpace, derived: dict[str, str]
) -> None:
    """Reject parameters that also have a fixed value, and names that the model lacks."""
    ingredients = {n for name, text in derived.items() for n in parse_expression(text, f"derived.{name}")[1]}
    for name in space.all_names:
        key = f"key 'parameters.{name}'" if name in space.names else f"key 'derived.{name}'"
        if name in given:
            raise InputError(key, "it also has a value in [model]", "only one of the two", "Remove one of them.")
        # A name that the model lacks must at least appear in the expression of a derived parameter.
        if name not in known and name not in ingredients:
            raise InputError(
                key,
                f"the model {kind.word} has no parameter '{name}'",
                ", ".join(kind.named_in_messages or known) + kind.note,
                suggestion(name, known),
            )


def true_model(section: ModelTable, channels: tuple[str, ...], folder: Path) -> Model:
    """Build the true model of a virtual experiment, which has no free parameters."""
    kind = kind_named(section.type, model_list.MODELS)
    return kind.build(ModelRequest(_given(section), ParameterSpace(), (), channels, folder))
