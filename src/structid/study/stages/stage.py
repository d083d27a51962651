"""A stage of a study: it takes the results of earlier stages and adds its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from structid.core.by_type import ByType
from structid.core.keys import Section
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling_result import SamplingResult
from structid.study.building.built_study import BuiltStudy
from structid.study.building.planned_stage import PlannedStage
from structid.study.folder_layout import STUDY, TIMINGS
from structid.study.schema.static_tables import RecordSection
from structid.study.timings import Stage, Timings

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Workplace:
    """Where and how a study runs."""

    folder: Path  # output folder
    stage: Stage  # opens a progress bar for a named stage
    executor: Any = None  # executor of an external model's runs
    retry: bool = False  # repeat failed runs of the campaign
    adopt: bool = False  # keep the model runs of another version of the model
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

    study: BuiltStudy  # the study, with the posterior and the sampler in use
    true_posterior: Posterior | None = None  # the posterior under the model itself
    results: ByType = ByType()  # noqa: RUF009 (never changed)  # results of the stages so far

    def having(self, kind: type[T], result: T | None) -> StudyState:
        """Return the state with a further result."""
        return replace(self, results=self.results.having(kind, result))


class StageTable(Section):
    """Keys of a table of the study file that asks for a stage."""

    word: ClassVar[str]  # name of the table
    store: ClassVar[str]  # file of the stage's work in the study's folder
    needs_draws: ClassVar[bool] = False  # whether it starts from draws of the posterior, and so from a measurement

    @property
    def records_to_read(self) -> tuple[RecordSection, ...]:
        """Further records of the table, under its key ``records``."""
        return ()

    @property
    def channels_to_record(self) -> tuple[str, ...]:
        """Channels of the model, where nothing is measured."""
        return ()

    def planned(self, study: BuiltStudy) -> PlannedStage:
        """Return the settings in SI; raise `InputError` where they do not fit the study."""
        raise NotImplementedError


@dataclass(frozen=True)
class StudyStage:
    """One stage.

    Parameters
    ----------
    result : type
        What it adds to the results; sections of the report and later stages find it by this type.
    wanted : callable
        Whether the study asks for it, given the state before it.
    run : callable
        Does the work, or reads back what was done, and returns the state with its result.
    table : type of StageTable, optional
        Its own table of the study file.

    Examples
    --------
    A stage whose result no other stage needs; `tests/architecture/trial/new_stage.py` has a table of the study file as well.

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
    """A stage that runs where the study file has its table."""

    def wanted(state: StudyState) -> bool:
        return planned in state.study.plans and (not table.needs_draws or SamplingResult in state.results)

    return StudyStage(result, wanted, run, table)
