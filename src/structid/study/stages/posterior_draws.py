"""Stage: draws of the posterior."""

from __future__ import annotations

from dataclasses import replace

from structid.inference.error_model_choice import ErrorModelChoice
from structid.inference.sample import sample
from structid.inference.sampling_result import SamplingResult
from structid.study.folder_layout import CHAINS
from structid.study.stages.error_model_stage import with_error_model
from structid.study.stages.stage import StudyStage, StudyState, Workplace

CHAINS_WITHOUT_HIDDEN = "chains_without_hidden.h5"
"""Draws under an error model without latent variables, used if one with latent variables cannot be sampled reliably."""


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    result, choice = _drawn(state, workplace, CHAINS), state.results.get(ErrorModelChoice)
    seconds = result.seconds
    if choice is not None and choice.posterior.error_model.inside and not result.verdict().converged:
        state = with_error_model(state, replace(choice, added_only=True))
        result = _drawn(state, workplace, CHAINS_WITHOUT_HIDDEN)
        seconds += result.seconds
    workplace.timings.put("sampling", seconds)
    return state.having(SamplingResult, result)


def _drawn(state: StudyState, workplace: Workplace, store: str) -> SamplingResult:
    study = state.study
    with workplace.stage("sampling") as progress, workplace.timings.measured("sampling"):
        return sample(study.sampled, study.sampler, study.file.seed, workplace.folder / store, progress=progress)


STAGE = StudyStage(
    SamplingResult,
    lambda state: state.study.posterior is not None and SamplingResult not in state.results,
    _run,
)
