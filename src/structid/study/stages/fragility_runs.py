"""Stage: probability of a passage or a failure, given the data, for records of increasing strength."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from structid.core.errors import InputError
from structid.core.keys import MetresPerSecondSquared
from structid.ground_motion.record import GroundMotion
from structid.inference.sampling_result import SamplingResult
from structid.reliability.fragility import Fragility, fragility
from structid.study.building.built_study import BuiltStudy
from structid.study.building.passage_limit import limit_of
from structid.study.building.planned_stage import PlannedStage
from structid.study.building.records import load_record
from structid.study.schema.static_tables import LARGEST_COUNT, RecordTable
from structid.study.stages.stage import StageTable, StudyState, Workplace, stage_of_table
from structid.surrogates.surrogate_list import DEFAULT


@dataclass(frozen=True)
class PlannedFragility(PlannedStage):
    """Settings of a fragility analysis."""

    what: ClassVar[str] = "records of rising strength"

    records: tuple[GroundMotion, ...]  # records to scale
    levels: tuple[float, ...]  # peak ground accelerations [m/s²] of the scaled records
    channel: str  # channel whose absolute value is compared with the limit
    limit: float  # limit in SI
    draws: int  # number of posterior draws
    surrogate: bool  # whether a surrogate replaces the model for most draws
    training: int  # number of draws to which the surrogate is fitted
    checks: int  # number of draws that correct the surrogate

    @property
    def model_runs(self) -> int:
        """Number of model runs: for all draws, or for the draws that train and correct a surrogate."""
        runs = self.training + self.checks if self.surrogate else self.draws
        return runs * len(self.records) * len(self.levels)


class FragilityTable(StageTable):
    """Probability of a passage or a failure, given the data, for records of increasing strength; see `fragility`."""

    word: ClassVar[str] = "fragility"
    store: ClassVar[str] = "fragility.journal"
    needs_draws: ClassVar[bool] = True

    channel: str
    limit: float | str
    pga: Annotated[tuple[MetresPerSecondSquared, ...], Field(min_length=1)]
    records: Annotated[tuple[RecordTable, ...], Field(min_length=1)]
    draws: int = Field(default=100, ge=10, le=LARGEST_COUNT)
    surrogate: bool | None = None
    training: int = Field(default=60, ge=10, le=LARGEST_COUNT)
    checks: int = Field(default=30, ge=5, le=LARGEST_COUNT)

    @property
    def records_to_read(self) -> tuple[RecordTable, ...]:
        """The records to scale."""
        return self.records

    def planned(self, study: BuiltStudy) -> PlannedFragility:
        """Read the records, and convert all values to SI."""
        records = tuple(load_record(r, study.folder, f"fragility.records.{i}") for i, r in enumerate(self.records, 1))
        surrogate = not study.model.batched if self.surrogate is None else self.surrogate
        needed = self.training + self.checks + 1
        if surrogate and self.draws < needed:
            raise InputError(
                "key 'fragility.draws'", f"{self.draws}, of which a surrogate needs {needed - 1}", f"{needed} or more"
            )
        return PlannedFragility(
            records,
            self.pga,
            self.channel,
            limit_of(self.limit, self.channel, study.model.recording(self.channel), "fragility.limit"),
            self.draws,
            surrogate,
            self.training,
            self.checks,
        )


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    planned, draws = state.study.planned_stages[PlannedFragility], state.results[SamplingResult]
    assert state.true_posterior is not None
    with (
        workplace.stage(planned.what) as progress,
        workplace.timings.measured(planned.what, goes_on=True),
    ):
        result = fragility(
            state.true_posterior,
            draws.thinned(planned.draws),
            planned.records,
            planned.channel,
            planned.limit,
            planned.levels,
            drift=draws.drift,
            surrogate=DEFAULT.made({}) if planned.surrogate else None,
            training=planned.training,
            checks=planned.checks,
            seed=state.study.file.seed,
            store=workplace.folder / FragilityTable.store,
            progress=progress,
        )
    return state.having(Fragility, result)


STAGE = stage_of_table(Fragility, FragilityTable, PlannedFragility, _run)
