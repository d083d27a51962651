"""A stage of somebody else's, with a table and a result of its own: the largest response, given the data."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import Field

from structid.inference.sampling_result import SamplingResult
from structid.study.building.planned_stage import PlannedStage
from structid.study.stages.stage import StageTable, stage_of_table


@dataclass(frozen=True)
class LargestResponse:
    """Largest absolute value of a channel over the record, for each draw."""

    channel: str
    peaks: np.ndarray

    def __str__(self):
        return f"Largest {self.channel}: {self.peaks.mean():.4g} m"


@dataclass(frozen=True)
class PlannedLargestResponse(PlannedStage):
    what: ClassVar[str] = "largest response"

    channel: str
    draws: int

    @property
    def model_runs(self):
        return self.draws


class LargestResponseTable(StageTable):
    word: ClassVar[str] = "largest_response"
    store: ClassVar[str] = "largest_response.npz"
    needs_draws: ClassVar[bool] = True

    channel: str
    draws: int = Field(default=50, ge=10)

    def planned(self, study):
        study.model.recording(self.channel)
        return PlannedLargestResponse(self.channel, self.draws)


def _run(state, workplace):
    planned = state.study.planned_stages[PlannedLargestResponse]
    store = workplace.folder / LargestResponseTable.store
    if not store.is_file():
        posterior = state.true_posterior
        theta = posterior.model_parameters(state.results[SamplingResult].thinned(planned.draws))
        model = posterior.model.recording(planned.channel)
        np.savez(store, peaks=np.abs(model.simulate(theta, state.study.record).channel(planned.channel)).max(axis=1))
    return state.having(LargestResponse, LargestResponse(planned.channel, np.load(store)["peaks"]))


STAGE = stage_of_table(LargestResponse, LargestResponseTable, PlannedLargestResponse, _run)
