"""The tables of every study file, and its text."""

from __future__ import annotations

import codecs
import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from structid.core.errors import InputError
from structid.core.keys import Section
from structid.study.schema.kinds import (
    DiscrepancySection,
    SamplerSection,
    SurrogateSection,
)
from structid.study.schema.static_tables import (
    CalibrationSection,
    CampaignSection,
    DeterministicSection,
    LoopSection,
    ModelSection,
    ObservationSection,
    PredictionSection,
    PriorSection,
    RecordSection,
)


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
    """A whole study, but for the tables of its stages (`study_reader.study_file` adds them)."""

    observation: Annotated[
        tuple[ObservationSection, ...], BeforeValidator(lambda v: (v,) if isinstance(v, dict) else v)
    ] = ()
    loop: LoopSection | None = None
    campaign: CampaignSection | None = None
    surrogate: SurrogateSection
    calibration: CalibrationSection | None = None
    deterministic: DeterministicSection = DeterministicSection()
    prediction: PredictionSection = PredictionSection()


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
