"""Stage: the model runs of a campaign."""

from __future__ import annotations

from structid.campaign.runner import Campaign
from structid.campaign.runs import Runs
from structid.campaign.store import CAMPAIGN_RUNS
from structid.study.stages.stage import StudyStage, StudyState, Workplace


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    study = state.study
    assert study.campaign is not None
    campaign = Campaign(
        study.model, study.campaign_records, study.campaign, workplace.folder / CAMPAIGN_RUNS, assignment="cycle"
    )
    attempts = 1 if study.file.campaign is None else study.file.campaign.attempts
    with workplace.stage("model runs") as progress, workplace.timings.measured("model runs", goes_on=True):
        runs = campaign.run(
            workplace.executor, retry=workplace.retry, attempts=attempts, adopt=workplace.adopt, progress=progress
        )
    return state.having(Runs, runs)


STAGE = StudyStage(Runs, lambda state: state.study.campaign is not None, _run)
