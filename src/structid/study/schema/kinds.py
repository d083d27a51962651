"""Tables whose keys depend on the kind of model, surrogate, error model or sampler.

The keys come from the lists of kinds, in which every kind declares its keys.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal, Union

from pydantic import Field, create_model, model_validator

from structid.core.keys import FileTable
from structid.inference.error_model_choice import AUTO
from structid.inference.error_models.error_model_kind import ErrorModelKind
from structid.inference.sampling.sampler_list import SamplerKind
from structid.models.model_kind import ModelKind
from structid.study.schema.static_tables import LARGEST_COUNT, ModelTable, PriorTable, VirtualTable
from structid.surrogates.surrogate_kind import SurrogateKind


class SurrogateTable(FileTable):
    """Keys that all kinds of surrogate share."""

    kind: str
    validation: int = Field(default=500, ge=10, le=LARGEST_COUNT)
    limit: float | None = Field(default=None, gt=0)
    outside: Literal["warn", "refuse", "allow"] | None = None
    trust: bool = False
    model_error: bool = False


class DiscrepancyTable(FileTable):
    """The error model, for the difference between measurement and model."""

    kind: str = AUTO


class SamplerTable(FileTable):
    """The sampler. The default settings converge in the benchmark study."""

    kind: str = "aies"


def model_table(kinds: Iterable[ModelKind]) -> Any:
    """Type of a table for one of several kinds of model."""
    sections = [_model_table(kind) for kind in kinds]
    if len(sections) == 1:
        return sections[0]
    return Annotated[Union[tuple(sections)], Field(discriminator="type")]  # noqa: UP007


def _model_table(kind: ModelKind) -> Any:
    checks: dict[str, Any] = {}
    if kind.check is not None:
        checks["_check"] = model_validator(mode="before")(kind.check)
    keys: dict[str, Any] = {
        name: (annotation if default is ... else annotation | None if default is None else annotation, default)
        for name, (annotation, default) in kind.keys.items()
    }
    tag: Any = Literal[kind.word]
    return create_model(f"{kind.word}_table", __base__=ModelTable, __validators__=checks, type=(tag, ...), **keys)


def virtual_table(kinds: Iterable[ModelKind]) -> Any:
    """Class of the table ``[observation.virtual]``."""
    model: Any = model_table(kinds)
    return create_model("virtual_table", __base__=VirtualTable, model=(model, ...))


def surrogate_table(kinds: Iterable[SurrogateKind]) -> Any:
    """Type of the surrogate table, with the keys of all kinds; every kind accepts some of these keys."""
    named = [kind for kind in kinds if kind.word]
    tag: Any = Literal[tuple(["none", *(kind.word for kind in named)])]
    keys: dict[str, Any] = {key: (type_ | None, None) for kind in named for key, type_ in kind.keys.items()}
    return create_model("surrogate_table", __base__=SurrogateTable, kind=(tag, ...), **keys)


def discrepancy_table(kinds: Iterable[ErrorModelKind]) -> Any:
    """Type of the error-model table, with the keys of all error models; every error model accepts some of these keys."""
    error_models = list(kinds)
    tag: Any = Literal[tuple([AUTO, *(error_model.word for error_model in error_models)])]
    number_or_prior: Any = float | str | PriorTable | None
    keys: dict[str, Any] = {
        name: (number_or_prior, None) for error_model in error_models for name in error_model.quantities
    }
    keys |= {name: key for error_model in error_models for name, key in error_model.switches.items()}
    return create_model("discrepancy_table", __base__=DiscrepancyTable, kind=(tag, AUTO), **keys)


def sampler_table(kinds: Iterable[SamplerKind]) -> Any:
    """Type of the sampler table, with the keys of all samplers; every sampler accepts some of these keys."""
    samplers = list(kinds)
    tag: Any = Literal[tuple(sampler.word for sampler in samplers)]
    keys: dict[str, Any] = {key: (type_ | None, None) for each in samplers for key, type_ in each.keys.items()}
    return create_model("sampler_table", __base__=SamplerTable, kind=(tag, "aies"), **keys)
