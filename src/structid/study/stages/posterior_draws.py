"""Draws of the posterior."""

from __future__ import annotations

from dataclasses import replace

from structid.inference.sample import sample
from structid.study.folder import CHAINS
from structid.study.stages.stage import Findings, StudyStage, Workplace


def _run(found: Findings, place: Workplace) -> Findings:
    study = found.study
    with place.stage("sampling") as progress, place.timings.measured("sampling"):
        result = sample(study.sampled, study.sampler, study.file.seed, place.folder / CHAINS, progress=progress)
    place.timings.put("sampling", result.seconds)
    return replace(found, result=result)


STAGE = StudyStage(lambda found: found.study.posterior is not None and found.result is None, _run)
