"""A stage of a study, which uses the results of earlier stages and adds its own result."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from structid.core.by_type import ByType
from structid.core.keys import FileTable
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult
from structid.study.building.built_study import BuiltStudy
from structid.study.building.planned_stage import PlannedStage
from structid.study.folder_layout import STUDY, TIMINGS
from structid.study.schema.static_tables import RecordTable
from structid.study.timings import Stage, Timings

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Workplace:
    """Output folder and execution settings of a study."""

    folder: Path  # output folder
    stage: Stage  # opens a progress bar for a stage
    executor: Any = None  # executor for the runs of an external model
    retry: bool = False  # whether to repeat failed runs of the campaign
    adopt: bool = False  # whether to keep the model runs of another version of the model
    page: bool = True  # whether to write the page

    @cached_property
    def timings(self) -> Timings:
        """Duration of every stage."""
        return Timings(self.folder / TIMINGS)

    @property
    def settings(self) -> str:
        """Text of the study file."""
        return (self.folder / STUDY).read_text(encoding="utf-8")


@dataclass(frozen=True, eq=False)
class StudyState:
    """A study between two stages."""

    study: BuiltStudy  # the study, with the current posterior and sampler
    true_posterior: Posterior | None = None  # the posterior with the model itself
    results: ByType = ByType()  # noqa: RUF009 (never changed)  # results of the stages so far

    def having(self, kind: type[T], result: T | None) -> StudyState:
        """Return the state with an additional result."""
        return replace(self, results=self.results.having(kind, result))


class StageTable(FileTable):
    """Keys of a table in the study file that requests a stage."""

    word: ClassVar[str]  # name of the table
    store: ClassVar[str]  # file with the work of the stage, in the folder of the study
    needs_draws: ClassVar[bool] = False  # whether it needs posterior draws, and thus a measurement

    @property
    def records_to_read(self) -> tuple[RecordTable, ...]:
        """Records of the table, from its key ``records``."""
        return ()

    @property
    def channels_to_record(self) -> tuple[str, ...]:
        """Channels that the model must record in a study without a measurement."""
        return ()

    @abstractmethod
    def planned(self, study: BuiltStudy) -> PlannedStage:
        """Return the settings in SI; raise `InputError` if they do not fit the study."""


@dataclass(frozen=True)
class StudyStage:
    """One stage of a study.

    Parameters
    ----------
    result : type
        Type of its result; sections of the report and later stages find the result by this type.
    wanted : callable
        Function of the state before the stage; returns whether the study requests the stage.
    run : callable
        Function that computes the result, or reads a stored result, and returns the state with this result.
    table : type of StageTable, optional
        Table of the stage in the study file.

    Examples
    --------
    A stage whose result no other stage needs; `tests/architecture/trial/new_stage.py` shows a stage with a table.

    >>> from structid.inference.sampling_result import SamplingResult
    >>> from structid.study.stages.stage import StudyStage
    >>> class Count(int):
    ...     '''Number of draws.'''
    >>> stage = StudyStage(
    ...     Count,
    ...     wanted=lambda state: SamplingResult in state.results,
    ...     run=lambda state, workplace: state.having(Count, Count(len(state.results[SamplingResult].flat))),
    ... )
    >>> stage.result.__name__
    'Count'
    """

    result: type
    wanted: Callable[[StudyState], bool]
    run: Callable[[StudyState, Workplace], StudyState]
    table: type[StageTable] | None = None


def stage_of_table(
    result: type,
    table: type[StageTable],
    planned: type[PlannedStage],
    run: Callable[[StudyState, Workplace], StudyState],
) -> StudyStage:
    """Create a stage that runs if the study file contains its table."""

    def wanted(state: StudyState) -> bool:
        return planned in state.study.planned_stages and (not table.needs_draws or SamplingResult in state.results)

    return StudyStage(result, wanted, run, table)
