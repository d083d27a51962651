"""Stage: runs over the priors, and what peaks and passages depend on."""

from __future__ import annotations

from dataclasses import replace

from structid.campaign.runner import Campaign
from structid.reliability.parameter_study import parameter_study
from structid.study.folder import PARAMETER_RUNS
from structid.study.stages.stage import Findings, StudyStage, Workplace


def _run(findings: Findings, workplace: Workplace) -> Findings:
    study = findings.study
    planned = study.parameter_study
    assert planned is not None
    campaign = Campaign(planned.model, study.record, planned.design, workplace.folder / PARAMETER_RUNS)
    what = "runs over the priors"
    with workplace.stage(what) as progress, workplace.timings.measured(what, goes_on=True):
        runs = campaign.run(workplace.executor, retry=workplace.retry, adopt=workplace.adopt, progress=progress)
    with workplace.timings.measured("studying them"):
        seed = study.file.seed
        tells = parameter_study(runs, planned.channel, planned.limits, planned.above, planned.peaks, seed)
    return replace(findings, parameter_study=tells)


STAGE = StudyStage(lambda found: found.study.parameter_study is not None, _run)
