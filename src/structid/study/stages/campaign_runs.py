"""True runs that a study asks for."""

from __future__ import annotations

from dataclasses import replace

from structid.campaign.runner import Campaign
from structid.campaign.store import CAMPAIGN_RUNS
from structid.study.stages.stage import Findings, StudyStage, Workplace


def _run(found: Findings, place: Workplace) -> Findings:
    study = found.study
    assert study.campaign is not None
    campaign = Campaign(
        study.model, study.campaign_records, study.campaign, place.folder / CAMPAIGN_RUNS, assignment="cycle"
    )
    attempts = 1 if study.file.campaign is None else study.file.campaign.attempts
    with place.stage("true runs") as progress, place.timings.measured("true runs", goes_on=True):
        runs = campaign.run(place.executor, retry=place.retry, attempts=attempts, adopt=place.adopt, progress=progress)
    return replace(found, runs=runs)


STAGE = StudyStage(lambda found: found.study.campaign is not None, _run)
