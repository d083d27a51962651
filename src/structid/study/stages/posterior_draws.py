"""Stage: draws of the posterior."""

from __future__ import annotations

from dataclasses import replace

from structid.inference.sample import sample
from structid.inference.sampling_result import SamplingResult
from structid.study.folder import CHAINS, CHAINS_WITHOUT_HIDDEN
from structid.study.stages.error_model_stage import with_error_model
from structid.study.stages.stage import Findings, StudyStage, Workplace


def _run(findings: Findings, workplace: Workplace) -> Findings:
    result, choice = _drawn(findings, workplace, CHAINS), findings.law_choice
    seconds = result.seconds
    if choice is not None and choice.posterior.error_model.inside and not result.verdict().converged:
        findings = with_error_model(findings, replace(choice, added_only=True))
        result = _drawn(findings, workplace, CHAINS_WITHOUT_HIDDEN)
        seconds += result.seconds
    workplace.timings.put("sampling", seconds)
    return replace(findings, result=result)


def _drawn(findings: Findings, workplace: Workplace, store: str) -> SamplingResult:
    study = findings.study
    with workplace.stage("sampling") as progress, workplace.timings.measured("sampling"):
        return sample(study.sampled, study.sampler, study.file.seed, workplace.folder / store, progress=progress)


STAGE = StudyStage(lambda found: found.study.posterior is not None and found.result is None, _run)
