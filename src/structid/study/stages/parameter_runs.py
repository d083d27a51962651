"""Stage: runs over the priors, first passages, and sensitivity of the peaks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from structid.campaign.runner import Campaign
from structid.core.errors import check_choice
from structid.core.units import to_si
from structid.models.base import Model
from structid.probability.designs import Design
from structid.reliability.parameter_study import ParameterStudy, parameter_study
from structid.study.building.built_study import BuiltStudy
from structid.study.building.passage_limit import limit_of
from structid.study.building.planned_stage import PlannedStage
from structid.study.schema.static_tables import LARGEST_COUNT
from structid.study.stages.stage import StageTable, StudyState, Workplace, stage_of_table


@dataclass(frozen=True)
class PlannedParameterStudy(PlannedStage):
    """Settings of a parameter study."""

    what: ClassVar[str] = "runs over the priors"

    design: Design  # points of the runs
    model: Model  # model of the study with the required channels
    channel: str  # channel of the passages
    limits: tuple[float, ...]  # limits in SI
    above: Mapping[str, float]  # lower bounds [SI] of the part of the prior range that is also studied separately
    peaks: tuple[str, ...]  # channels for whose peaks Sobol' indices are computed

    @property
    def model_runs(self) -> int:
        """Number of model runs: one per point."""
        return len(self.design)

    @property
    def identity(self) -> dict[str, Any]:
        """The points of the design."""
        return {"parameter study": self.design.values}


class ParameterStudyTable(StageTable):
    """Runs over the priors: first passages of limits, and sensitivity of the peaks; see `parameter_study`."""

    word: ClassVar[str] = "parameter_study"
    store: ClassVar[str] = "parameter_study.h5"

    runs: int = Field(ge=20, le=LARGEST_COUNT)
    method: Literal["latin_hypercube", "maximin", "sobol", "random"] = "latin_hypercube"
    seed: int | None = Field(default=None, ge=0)
    channel: str
    limits: Annotated[tuple[float | str, ...], Field(min_length=1)]
    above: dict[str, float | str] = Field(default_factory=dict)
    peaks: tuple[str, ...] = ()

    @property
    def channels_to_record(self) -> tuple[str, ...]:
        """The channel of the passages."""
        return (self.channel,)

    def planned(self, study: BuiltStudy) -> PlannedParameterStudy:
        """Draw the points, and convert limits and bounds to SI."""
        space = study.space
        design = space.sample(self.runs, study.file.seed if self.seed is None else self.seed, self.method)
        model = study.model.recording(*dict.fromkeys((self.channel, *self.peaks)))
        limits = tuple(limit_of(limit, self.channel, model, "parameter_study.limits") for limit in self.limits)
        for name in self.above:
            check_choice("table 'parameter_study.above'", name, space.names)
        above = {n: to_si(v, space.units[n], f"key 'parameter_study.above.{n}'") for n, v in self.above.items()}
        return PlannedParameterStudy(design, model, self.channel, limits, above, self.peaks)


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    study = state.study
    planned = study.planned_stages[PlannedParameterStudy]
    campaign = Campaign(planned.model, study.record, planned.design, workplace.folder / ParameterStudyTable.store)
    with workplace.stage(planned.what) as progress, workplace.timings.measured(planned.what, goes_on=True):
        runs = campaign.run(workplace.executor, retry=workplace.retry, adopt=workplace.adopt, progress=progress)
    with workplace.timings.measured("studying them"):
        result = parameter_study(
            runs, planned.channel, planned.limits, planned.above, planned.peaks, seed=study.file.seed
        )
    return state.having(ParameterStudy, result)


STAGE = stage_of_table(ParameterStudy, ParameterStudyTable, PlannedParameterStudy, _run)
