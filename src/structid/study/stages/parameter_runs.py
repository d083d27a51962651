"""Runs over the priors, and what they tell of them."""

from __future__ import annotations

from dataclasses import replace

from structid.campaign.runner import Campaign
from structid.reliability.parameter_study import parameter_study
from structid.study.folder import PARAMETER_RUNS
from structid.study.stages.stage import Findings, StudyStage, Workplace


def _run(found: Findings, place: Workplace) -> Findings:
    study = found.study
    planned = study.parameter_study
    assert planned is not None
    campaign = Campaign(planned.model, study.record, planned.design, place.folder / PARAMETER_RUNS)
    what = "runs over the priors"
    with place.stage(what) as progress, place.timings.measured(what, goes_on=True):
        runs = campaign.run(place.executor, retry=place.retry, adopt=place.adopt, progress=progress)
    with place.timings.measured("studying them"):
        seed = study.file.seed
        tells = parameter_study(runs, planned.channel, planned.limits, planned.above, planned.peaks, seed)
    return replace(found, parameter_study=tells)


STAGE = StudyStage(lambda found: found.study.parameter_study is not None, _run)
