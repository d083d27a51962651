"""Build the study of a cyclic test from its file; everything is checked before a law is fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError, within
from structid.data_files.read_file import read_table
from structid.data_files.tables.pick_column import values_of_column
from structid.ground_motion.record import GroundMotion
from structid.inference.error_models.base import ErrorModel
from structid.law_choice.cyclic_test import CyclicTest
from structid.law_choice.law_comparison import ERROR_MODELS
from structid.mechanics.hysteretic_laws.law_list import INELASTIC, law_of
from structid.models.hysteretic.hysteretic import AUTO
from structid.study.building.records import load_record
from structid.study.cyclic_tests.cyclic_test_file import CyclicTestFile, FurtherPathTable, read_cyclic_test
from structid.study.schema.problems import StudyErrors


@dataclass(frozen=True, eq=False)
class PlannedCyclicTest:
    """A study of a cyclic test that is ready to run."""

    file: CyclicTestFile  # content of the file
    test: CyclicTest
    laws: tuple[str, ...]  # names of the laws to choose among
    paths: dict[str, np.ndarray]  # further displacement histories by name [m]
    records: tuple[GroundMotion, ...]  # excitations of the oscillator

    @property
    def error_models(self) -> tuple[ErrorModel, ...]:
        """Error models to choose among."""
        return ERROR_MODELS[self.file.discrepancy.kind]


def load_cyclic_test(path: str | Path) -> PlannedCyclicTest:
    """Read a file and build its study."""
    return planned_cyclic_test(read_cyclic_test(path), Path(path).resolve().parent)


def planned_cyclic_test(file: CyclicTestFile, folder: Path) -> PlannedCyclicTest:
    """Build a study, or report the problems of all its parts."""
    problems: list[str] = []

    def part(build: Callable[[], object]) -> object:
        try:
            return build()
        except InputError as error:
            problems.append(str(error))
            return None

    test = part(lambda: _test(file, folder))
    laws = part(lambda: _laws(file))
    paths = part(lambda: _paths(file, folder, test)) if isinstance(test, CyclicTest) else {}
    sections = () if file.dynamics is None else file.dynamics.records
    records = [
        part(lambda i=i, section=section: load_record(section, folder, f"dynamics.records.{i}"))  # type: ignore[misc]
        for i, section in enumerate(sections, start=1)
    ]
    if problems:
        raise StudyErrors(file.name, problems)
    assert isinstance(test, CyclicTest) and isinstance(laws, tuple) and isinstance(paths, dict)
    return PlannedCyclicTest(file, test, laws, paths, tuple(r for r in records if isinstance(r, GroundMotion)))


def _test(file: CyclicTestFile, folder: Path) -> CyclicTest:
    settings = file.cyclic_test.model_dump(exclude={"file"})
    with within("table 'cyclic_test'"):
        return CyclicTest.read(folder / file.cyclic_test.file, **settings, name=file.name)


def _laws(file: CyclicTestFile) -> tuple[str, ...]:
    """Names of the laws; all except the linear spring for ``auto``."""
    given = file.model.law
    names = INELASTIC if given == AUTO else (given,) if isinstance(given, str) else given
    for name in names:
        law_of("key 'model.law'", name)
    return names


def _paths(file: CyclicTestFile, folder: Path, test: CyclicTest) -> dict[str, np.ndarray]:
    paths: dict[str, np.ndarray] = {}
    if file.prediction and test.first is None:
        came = f"a test with {len(test.turns)} turning points"
        raise InputError("table 'prediction'", came, "three or more half-cycles, which show the error of a prediction")
    for section in file.prediction:
        where = f"table 'prediction', {section.name}"
        if section.name in paths:
            raise InputError(where, "a second table of this name", "different names")
        with within(where):
            # The path itself is checked as the test is: it has enough samples, and it moves.
            paths[section.name] = test.along(_path(section, folder, test, where)).displacement
    return paths


def _path(section: FurtherPathTable, folder: Path, test: CyclicTest, where: str) -> Float[np.ndarray, " time"]:
    if (section.file is None) == (section.scale is None):
        came = "neither file nor scale" if section.file is None else "both file and scale"
        raise InputError(where, came, "exactly one of the two")
    if section.scale is not None:
        return section.scale * test.displacement
    if section.unit is None:
        raise InputError(where, "a file without a unit", "the unit of the displacements", 'For example: unit = "mm".')
    return values_of_column(read_table(folder / str(section.file)), section.column, section.unit, "m")
