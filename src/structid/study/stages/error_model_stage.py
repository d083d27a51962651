"""Stage: choice of the error model from the data."""

from __future__ import annotations

from dataclasses import replace

from structid.core.streams import Purpose, derived_seed
from structid.inference.error_model_choice import ErrorModelChoice, choose_among
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.base import Sampler
from structid.inference.sampling.smc.smc import SMC
from structid.study.building.built_study import BuiltStudy
from structid.study.building.samplers import build_sampler
from structid.study.stages.stage import StudyStage, StudyState, Workplace
from structid.surrogates.base import Surrogate

CHOICE = "laws"
"""Folder of the draws under the candidate error models."""

WITH_HIDDEN_VALUES = SMC(
    particles=500, ensembles=4, steps=250, effective_share=0.5, correlation=0.4, independent=0.2, scouts=0
)
"""Default sampler for drifting parameters, which add tens of latent variables: the values at the knots."""

FOR_CORRELATED_ERRORS = SMC(particles=500, steps=300)
"""Default sampler for correlated errors: a heavy-tailed variance needs about a hundred moves."""


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    study, true_posterior = state.study, state.true_posterior
    assert true_posterior is not None
    # A surrogate, if there is one, makes the proposals and determines the choice of the error model.
    surrogate = state.results.get(Surrogate)
    posterior = study.sampled if surrogate is None else true_posterior.on(surrogate)
    if posterior.costs_runs:  # the choice would take tens of thousands of runs of an external solver
        return state
    what, seed = "choosing the error model", derived_seed(study.file.seed, Purpose.LAW_CHOICE)
    with workplace.stage(what) as progress, workplace.timings.measured(what):
        choice = choose_among(posterior, seed=seed, progress=progress, store=workplace.folder / CHOICE)
    return with_error_model(state, choice)


def with_error_model(state: StudyState, choice: ErrorModelChoice) -> StudyState:
    """Adopt the chosen error model."""
    study, error_model = state.study, choice.posterior.error_model
    assert state.true_posterior is not None
    posterior = study.sampled.on(error_model=error_model)
    sampler = sampler_under(study, posterior)
    named = "sampler" in study.file.model_fields_set
    another = sampler is WITH_HIDDEN_VALUES and named and _too_few(build_sampler(study.file.sampler), posterior)
    state = replace(
        state,
        true_posterior=state.true_posterior.on(error_model=error_model),
        study=replace(study, posterior=posterior, sampler=sampler),
    )
    remark = _remark(study, posterior) if another else ""
    return state.having(ErrorModelChoice, replace(choice, remark=remark))


def sampler_under(study: BuiltStudy, posterior: Posterior) -> Sampler:
    """Choose the sampler for a posterior under a given error model."""
    sampler = study.sampler if study.sampler.exact else build_sampler(study.file.sampler)
    named = "sampler" in study.file.model_fields_set
    if posterior.error_model.inside:
        return sampler if named and sampler != SMC() and not _too_few(sampler, posterior) else WITH_HIDDEN_VALUES
    return sampler if named or posterior.error_model.added.independent else FOR_CORRELATED_ERRORS


def _too_few(sampler: Sampler, posterior: Posterior) -> bool:
    """Whether a sampler has too few walkers for the values at the knots."""
    return sampler.interacting and sampler.walkers < 2 * posterior.dimension


def _remark(study: BuiltStudy, posterior: Posterior) -> str:
    """Remark on the replacement of the study's sampler."""
    walkers, dimension = build_sampler(study.file.sampler).walkers, posterior.dimension
    return (
        f"The {walkers} walkers of the study's sampler are too few for {dimension} parameters, including the values at the knots; "
        f"at least {2 * dimension} are needed. Sampler used instead: {WITH_HIDDEN_VALUES.in_words}."
    )


def _wanted(state: StudyState) -> bool:
    study = state.study
    return study.posterior is not None and study.error_model_is_open and study.plan is None


STAGE = StudyStage(ErrorModelChoice, _wanted, _run)
