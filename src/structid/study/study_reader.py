"""Reading and checking of study files; their tables accept the keys of every registered kind and stage."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pydantic
from pydantic import BeforeValidator, create_model

from structid.inference.error_models import error_model_list
from structid.inference.error_models.error_model_kind import ErrorModelKind
from structid.inference.sampling import sampler_list
from structid.inference.sampling.sampler_list import SamplerKind
from structid.models import model_list
from structid.models.model_kind import ModelKind
from structid.study.schema.kinds import (
    discrepancy_table,
    model_table,
    sampler_table,
    surrogate_table,
    virtual_table,
)
from structid.study.schema.problems import StudyErrors, problem
from structid.study.schema.static_tables import ObservationTable
from structid.study.schema.study_file import StudyFile, study_content
from structid.study.stages import stage_list
from structid.study.stages.stage import StageTable
from structid.surrogates import surrogate_list as surrogates
from structid.surrogates.surrogate_kind import SurrogateKind


def study_file() -> type[StudyFile]:
    """Type of a study file, with the currently registered kinds."""
    return _study_file(
        model_list.MODELS,
        tuple(surrogates.KINDS),
        tuple(error_model_list.ERROR_MODELS),
        tuple(sampler_list.SAMPLERS),
        stage_list.tables(),
    )


@functools.cache
def _study_file(
    model_kinds: tuple[ModelKind, ...],
    surrogate_kinds: tuple[SurrogateKind, ...],
    error_model_kinds: tuple[ErrorModelKind, ...],
    sampler_kinds: tuple[SamplerKind, ...],
    stage_tables: tuple[type[StageTable], ...],
) -> type[StudyFile]:
    virtual: Any = virtual_table(kind for kind in model_kinds if not kind.is_a_solver)
    observation: Any = create_model("observation_table", __base__=ObservationTable, virtual=(virtual | None, None))
    surrogate: Any = surrogate_table(surrogate_kinds)
    discrepancy: Any = discrepancy_table(error_model_kinds)
    sampler: Any = sampler_table(sampler_kinds)
    one_or_several: Any = Annotated[
        tuple[observation, ...], BeforeValidator(lambda v: (v,) if isinstance(v, dict) else v)
    ]
    tables: dict[str, Any] = {table.word: (table | None, None) for table in stage_tables}
    result: type[StudyFile] = create_model(
        "StudyFile",
        __base__=StudyFile,
        model=(model_table(model_kinds), ...),
        observation=(one_or_several, ()),
        surrogate=(surrogate, surrogate(kind="none")),
        discrepancy=(discrepancy, discrepancy()),
        sampler=(sampler, sampler()),
        **tables,
    )
    return result


def stage_tables(file: StudyFile) -> Iterator[StageTable]:
    """The stage tables of a study file, in the order of the stages."""
    for table in stage_list.tables():
        if (given := getattr(file, table.word, None)) is not None:
            yield given


def stands_alone(file: StudyFile) -> bool:
    """Whether a table requests a stage that needs no measurement."""
    return any(not table.needs_draws for table in stage_tables(file))


def read_study(path: str | Path) -> StudyFile:
    """Read a study file and check every key."""
    return parse_study(study_content(path), str(path))


def parse_study(content: dict[str, Any], path: str = "study") -> StudyFile:
    """Check the content of a study file."""
    try:
        return study_file().model_validate(content)
    except pydantic.ValidationError as errors:
        problems = dict.fromkeys(problem(error, content, study_file()) for error in errors.errors())
        raise StudyErrors(path, list(problems)) from None
