"""Draws of the posterior."""

from __future__ import annotations

from dataclasses import replace

from structid.inference.sample import sample
from structid.inference.sampling_result import SamplingResult
from structid.study.folder import CHAINS, CHAINS_WITHOUT_HIDDEN
from structid.study.stages.error_model_stage import with_law
from structid.study.stages.stage import Findings, StudyStage, Workplace


def _run(found: Findings, place: Workplace) -> Findings:
    result, choice = _drawn(found, place, CHAINS), found.law_choice
    seconds = result.seconds
    if choice is not None and choice.posterior.law.inside and not result.verdict().converged:
        found = with_law(found, replace(choice, added_only=True))
        result = _drawn(found, place, CHAINS_WITHOUT_HIDDEN)
        seconds += result.seconds
    place.timings.put("sampling", seconds)
    return replace(found, result=result)


def _drawn(found: Findings, place: Workplace, store: str) -> SamplingResult:
    study = found.study
    with place.stage("sampling") as progress, place.timings.measured("sampling"):
        return sample(study.sampled, study.sampler, study.file.seed, place.folder / store, progress=progress)


STAGE = StudyStage(lambda found: found.study.posterior is not None and found.result is None, _run)
