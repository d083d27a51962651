"""Stage: the probability of a passage or a failure, given the data, for records of increasing strength."""

from __future__ import annotations

from dataclasses import replace

from structid.reliability.fragility import fragility
from structid.study.folder import FRAGILITY
from structid.study.stages.stage import Findings, StudyStage, Workplace
from structid.surrogates.surrogate_list import DEFAULT


def _run(findings: Findings, workplace: Workplace) -> Findings:
    study, result = findings.study, findings.result
    planned = study.fragility
    assert planned is not None and result is not None and findings.true_posterior is not None
    what = "records of rising strength"
    with workplace.stage(what) as progress, workplace.timings.measured(what, goes_on=True):
        tells = fragility(
            findings.true_posterior,
            result.thinned(planned.draws),
            planned.records,
            planned.channel,
            planned.limit,
            planned.levels,
            drift=result.drift,
            surrogate=DEFAULT.made({}) if planned.surrogate else None,
            training=planned.training,
            checks=planned.checks,
            seed=study.file.seed,
            store=workplace.folder / FRAGILITY,
            progress=progress,
        )
    return replace(findings, fragility=tells)


STAGE = StudyStage(lambda found: found.study.fragility is not None and found.result is not None, _run)
