"""A whole study file: its tables, and how it is read and checked."""

from __future__ import annotations

import codecs
import functools
import tomllib
from pathlib import Path
from typing import Annotated, Any

import pydantic
from pydantic import BeforeValidator, Field, create_model

from structid.core.errors import InputError
from structid.core.keys import Section
from structid.inference.error_models import error_model_list
from structid.inference.error_models.error_model_kind import ErrorModelKind
from structid.inference.sampling import sampler_list
from structid.inference.sampling.sampler_list import SamplerKind
from structid.models import model_list
from structid.models.model_kind import ModelKind
from structid.study.schema.kinds import (
    DiscrepancySection,
    SamplerSection,
    SurrogateSection,
    discrepancy_section,
    model_section,
    sampler_section,
    surrogate_section,
    virtual_section,
)
from structid.study.schema.problems import StudyErrors, problem
from structid.study.schema.static_tables import (
    CalibrationSection,
    CampaignSection,
    DeterministicSection,
    FragilitySection,
    LoopSection,
    ModelSection,
    ObservationSection,
    ParameterStudySection,
    PredictionSection,
    PriorSection,
    RecordSection,
)
from structid.surrogates import surrogate_list as surrogates
from structid.surrogates.surrogate_kind import SurrogateKind


class CalibrationFile(Section):
    """Tables of every file that calibrates a model."""

    name: str
    title: str = ""
    seed: int = Field(default=1, ge=0)
    record: RecordSection
    model: ModelSection
    parameters: dict[str, PriorSection] = Field(min_length=1)
    derived: dict[str, str] = Field(default_factory=dict)
    coordinates: dict[str, str] = Field(default_factory=dict)
    correlation: dict[str, float] = Field(default_factory=dict)
    discrepancy: DiscrepancySection
    sampler: SamplerSection


class StudyFile(CalibrationFile):
    """A whole study."""

    observation: Annotated[
        tuple[ObservationSection, ...], BeforeValidator(lambda v: (v,) if isinstance(v, dict) else v)
    ] = ()
    loop: LoopSection | None = None
    campaign: CampaignSection | None = None
    parameter_study: ParameterStudySection | None = None
    surrogate: SurrogateSection
    calibration: CalibrationSection | None = None
    deterministic: DeterministicSection = DeterministicSection()
    prediction: PredictionSection = PredictionSection()
    fragility: FragilitySection | None = None


def study_file() -> type[StudyFile]:
    """Type of a study file, with the kinds registered now."""
    return _study_file(
        model_list.MODELS, tuple(surrogates.KINDS), tuple(error_model_list.ERROR_MODELS), tuple(sampler_list.SAMPLERS)
    )


@functools.cache
def _study_file(
    model_kinds: tuple[ModelKind, ...],
    surrogate_kinds: tuple[SurrogateKind, ...],
    law_kinds: tuple[ErrorModelKind, ...],
    sampler_kinds: tuple[SamplerKind, ...],
) -> type[StudyFile]:
    virtual: Any = virtual_section(kind for kind in model_kinds if not kind.is_a_solver)
    observation: Any = create_model("observation_section", __base__=ObservationSection, virtual=(virtual | None, None))
    surrogate: Any = surrogate_section(surrogate_kinds)
    discrepancy: Any = discrepancy_section(law_kinds)
    sampler: Any = sampler_section(sampler_kinds)
    one_or_several: Any = Annotated[
        tuple[observation, ...], BeforeValidator(lambda v: (v,) if isinstance(v, dict) else v)
    ]
    result: type[StudyFile] = create_model(
        "StudyFile",
        __base__=StudyFile,
        model=(model_section(model_kinds), ...),
        observation=(one_or_several, ()),
        surrogate=(surrogate, surrogate(kind="none")),
        discrepancy=(discrepancy, discrepancy()),
        sampler=(sampler, sampler()),
    )
    return result


def read_study(path: str | Path) -> StudyFile:
    """Read a study file and check every key."""
    return parse_study(study_content(path), str(path))


def study_content(path: str | Path) -> dict[str, Any]:
    """Read the tables of a study file."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{path}", "there is no such file", "a study file", "Make one with: structid new NAME.")
    try:
        return tomllib.loads(study_text(file))
    except tomllib.TOMLDecodeError as cause:
        raise InputError(
            f"{path}",
            f"it is no TOML: {cause}",
            "a TOML file",
            'A text value needs quotes: mass = "12 t". Decimals have a point: 0.5.',
        ) from None


def study_text(file: Path) -> str:
    """Read the text of a study file: UTF-8 or UTF-16, as editors save it."""
    raw = file.read_bytes()
    try:
        marked = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return raw.decode("utf-16" if marked else "utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as cause:
        line = raw[: cause.start].count(b"\n") + 1
        character = raw[cause.start : cause.start + 1].decode("latin-1")
        raise InputError(
            f"{file}, line {line}",
            f"a byte that is no UTF-8 (in Latin-1 it would be '{character}')",
            "a text file in UTF-8",
            "Save it as UTF-8, which every editor offers.",
        ) from None


def parse_study(content: dict[str, Any], path: str = "study") -> StudyFile:
    """Check the content of a study file."""
    try:
        return study_file().model_validate(content)
    except pydantic.ValidationError as errors:
        problems = dict.fromkeys(problem(error, content, study_file()) for error in errors.errors())
        raise StudyErrors(path, list(problems)) from None
