"""Stage: the model runs of a campaign."""

from __future__ import annotations

from dataclasses import replace

from structid.campaign.runner import Campaign
from structid.campaign.store import CAMPAIGN_RUNS
from structid.study.stages.stage import Findings, StudyStage, Workplace


def _run(findings: Findings, workplace: Workplace) -> Findings:
    study = findings.study
    assert study.campaign is not None
    campaign = Campaign(
        study.model, study.campaign_records, study.campaign, workplace.folder / CAMPAIGN_RUNS, assignment="cycle"
    )
    attempts = 1 if study.file.campaign is None else study.file.campaign.attempts
    with workplace.stage("true runs") as progress, workplace.timings.measured("true runs", goes_on=True):
        runs = campaign.run(
            workplace.executor, retry=workplace.retry, attempts=attempts, adopt=workplace.adopt, progress=progress
        )
    return replace(findings, runs=runs)


STAGE = StudyStage(lambda found: found.study.campaign is not None, _run)
