"""The file of a study of a cyclic test: its tables, and functions to read and check it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from structid.core.keys import FileTable, Fraction, quantity
from structid.study.schema.problems import StudyErrors, problem
from structid.study.schema.static_tables import LoopColumnsTable, RecordTable
from structid.study.schema.study_file import study_content

Kilograms: Any = quantity("kg")


class MeasuredTestTable(LoopColumnsTable):
    """Columns of displacement and force; see `CyclicTest.read`."""

    missing: Literal["refuse", "leave_out"] = "refuse"


class LawTable(FileTable):
    """The hysteretic law by name, several laws to choose among, or ``auto`` for all laws."""

    type: Literal["hysteretic"] = "hysteretic"
    law: str | tuple[str, ...] = "auto"


class TestErrorTable(FileTable):
    """The error model; ``auto`` fits the laws with independent and with AR(1) errors."""

    __test__ = False

    kind: Literal["auto", "iid", "ar1"] = "auto"


class FurtherPathTable(FileTable):
    """Another displacement history whose force is predicted: a file, or the test's history times a factor."""

    name: str
    scale: float | None = None
    file: str | None = None
    unit: str | None = None
    column: int | str = 0


class DynamicsTable(FileTable):
    """The specimen as the spring of an oscillator, under records."""

    mass: Annotated[Kilograms, Field(gt=0)]
    damping_ratio: Annotated[Fraction, Field(ge=0, lt=1)] = 0.0
    draws: int = Field(default=200, ge=20, le=10_000)
    records: tuple[RecordTable, ...] = Field(min_length=1)


class CyclicTestFile(FileTable):
    """A study of a cyclic test."""

    name: str
    title: str = ""
    seed: int = Field(default=1, ge=0)
    cyclic_test: MeasuredTestTable
    model: LawTable = LawTable()
    discrepancy: TestErrorTable = TestErrorTable()
    prediction: tuple[FurtherPathTable, ...] = ()
    dynamics: DynamicsTable | None = None


def is_cyclic_test(content: dict[str, Any]) -> bool:
    """Whether a file describes a study of a cyclic test."""
    return "cyclic_test" in content


def read_cyclic_test(path: str | Path) -> CyclicTestFile:
    """Read the file of a study of a cyclic test, and check every key."""
    return parse_cyclic_test(study_content(path), str(path))


def parse_cyclic_test(content: dict[str, Any], path: str) -> CyclicTestFile:
    """Check the content of a file."""
    try:
        return CyclicTestFile.model_validate(content)
    except pydantic.ValidationError as errors:
        problems = dict.fromkeys(problem(error, content, CyclicTestFile) for error in errors.errors())
        raise StudyErrors(path, list(problems)) from None
