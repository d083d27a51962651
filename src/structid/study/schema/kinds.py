"""Tables whose keys depend on a kind: of model, surrogate, error model, sampler.

The keys come from the lists of kinds, where each kind declares its own.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal, Union

from pydantic import Field, create_model, model_validator

from structid.core.keys import Section
from structid.inference.error_model_choice import AUTO
from structid.inference.error_models.error_model_kind import ErrorModelKind
from structid.inference.sampling.sampler_list import SamplerKind
from structid.models.model_kind import ModelKind
from structid.study.schema.static_tables import LARGEST_COUNT, ModelSection, PriorSection, VirtualSection
from structid.surrogates.surrogate_kind import SurrogateKind


class SurrogateSection(Section):
    """Keys of a surrogate of any kind."""

    kind: str
    validation: int = Field(default=500, ge=10, le=LARGEST_COUNT)
    limit: float | None = Field(default=None, gt=0)
    outside: Literal["warn", "refuse", "allow"] | None = None
    trust: bool = False
    model_error: bool = False


class DiscrepancySection(Section):
    """The error model: the difference between measurement and model."""

    kind: str = AUTO


class SamplerSection(Section):
    """The sampler. Omitted settings converge in the benchmark study."""

    kind: str = "aies"


def model_section(kinds: Iterable[ModelKind]) -> Any:
    """Type of a table that names one of several kinds of model."""
    sections = [_model_section(kind) for kind in kinds]
    if len(sections) == 1:
        return sections[0]
    return Annotated[Union[tuple(sections)], Field(discriminator="type")]  # noqa: UP007


def _model_section(kind: ModelKind) -> Any:
    checks: dict[str, Any] = {}
    if kind.check is not None:
        checks["_check"] = model_validator(mode="before")(kind.check)
    keys: dict[str, Any] = {
        name: (annotation if default is ... else annotation | None if default is None else annotation, default)
        for name, (annotation, default) in kind.keys.items()
    }
    tag: Any = Literal[kind.word]
    return create_model(f"{kind.word}_section", __base__=ModelSection, __validators__=checks, type=(tag, ...), **keys)


def virtual_section(kinds: Iterable[ModelKind]) -> Any:
    """Type of the table of a virtual experiment."""
    model: Any = model_section(kinds)
    return create_model("virtual_section", __base__=VirtualSection, model=(model, ...))


def surrogate_section(kinds: Iterable[SurrogateKind]) -> Any:
    """Type of a surrogate's table: the keys of all kinds, each of which accepts some."""
    named = [kind for kind in kinds if kind.word]
    tag: Any = Literal[tuple(["none", *(kind.word for kind in named)])]
    keys: dict[str, Any] = {key: (type_ | None, None) for kind in named for key, type_ in kind.keys.items()}
    return create_model("surrogate_section", __base__=SurrogateSection, kind=(tag, ...), **keys)


def discrepancy_section(kinds: Iterable[ErrorModelKind]) -> Any:
    """Type of an error model's table: the keys of all error models, each of which accepts some."""
    error_models = list(kinds)
    tag: Any = Literal[tuple([AUTO, *(error_model.word for error_model in error_models)])]
    number_or_prior: Any = float | str | PriorSection | None
    keys: dict[str, Any] = {
        name: (number_or_prior, None) for error_model in error_models for name in error_model.quantities
    }
    keys |= {name: key for error_model in error_models for name, key in error_model.switches.items()}
    return create_model("discrepancy_section", __base__=DiscrepancySection, kind=(tag, AUTO), **keys)


def sampler_section(kinds: Iterable[SamplerKind]) -> Any:
    """Type of a sampler's table: the keys of all samplers, each of which accepts some."""
    samplers = list(kinds)
    tag: Any = Literal[tuple(sampler.word for sampler in samplers)]
    keys: dict[str, Any] = {key: (type_ | None, None) for each in samplers for key, type_ in each.keys.items()}
    return create_model("sampler_section", __base__=SamplerSection, kind=(tag, "aies"), **keys)
