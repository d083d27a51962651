"""The tables and the text of study files."""

from __future__ import annotations

import codecs
import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from structid.core.errors import InputError
from structid.core.keys import FileTable
from structid.study.schema.kinds import (
    DiscrepancyTable,
    SamplerTable,
    SurrogateTable,
)
from structid.study.schema.static_tables import (
    CalibrationTable,
    CampaignTable,
    DeterministicTable,
    LoopTable,
    ModelTable,
    ObservationTable,
    PredictionTable,
    PriorTable,
    RecordTable,
)


class CalibrationFile(FileTable):
    """Tables that all files for the calibration of a model share."""

    name: str
    title: str = ""
    seed: int = Field(default=1, ge=0)
    record: RecordTable
    model: ModelTable
    parameters: dict[str, PriorTable] = Field(default_factory=dict)
    derived: dict[str, str] = Field(default_factory=dict)
    coordinates: dict[str, str] = Field(default_factory=dict)
    correlation: dict[str, float] = Field(default_factory=dict)
    discrepancy: DiscrepancyTable
    sampler: SamplerTable


class StudyFile(CalibrationFile):
    """A whole study, except for the tables of its stages, which `study_reader.study_file` adds."""

    observation: Annotated[
        tuple[ObservationTable, ...], BeforeValidator(lambda v: (v,) if isinstance(v, dict) else v)
    ] = ()
    loop: LoopTable | None = None
    campaign: CampaignTable | None = None
    surrogate: SurrogateTable
    calibration: CalibrationTable | None = None
    deterministic: DeterministicTable = DeterministicTable()
    prediction: PredictionTable = PredictionTable()


def study_content(path: str | Path) -> dict[str, Any]:
    """Read the tables of a study file."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f"{path}", "the file does not exist", "a study file", "Create one with: structid new NAME.")
    try:
        return tomllib.loads(study_text(file))
    except tomllib.TOMLDecodeError as cause:
        raise InputError(
            f"{path}",
            f"it is not valid TOML: {cause}",
            "a TOML file",
            'Put text values in quotes, as in mass = "12 t", and use a decimal point, as in 0.5.',
        ) from None


def study_text(file: Path) -> str:
    """Read the text of a study file in UTF-8 or UTF-16."""
    raw = file.read_bytes()
    try:
        marked = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return raw.decode("utf-16" if marked else "utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as cause:
        line = raw[: cause.start].count(b"\n") + 1
        character = raw[cause.start : cause.start + 1].decode("latin-1")
        raise InputError(
            f"{file}, line {line}",
            f"a byte that is not valid UTF-8 (in Latin-1, it is '{character}')",
            "a text file in UTF-8",
            "Save the file as UTF-8 in your editor.",
        ) from None
