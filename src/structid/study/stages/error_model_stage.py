"""Stage: the choice of the error model by the data."""

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
"""Folder of the draws under each error model of a choice."""

WITH_HIDDEN_VALUES = SMC(
    particles=500, ensembles=4, steps=250, effective_share=0.5, correlation=0.4, independent=0.2, scouts=0
)
"""Default sampler where parameters drift: the values at the knots are tens of latent variables."""

FOR_CORRELATED_ERRORS = SMC(particles=500, steps=300)
"""Default sampler where errors are correlated: a variance with a heavy tail takes a hundred moves."""


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    study, true_posterior = state.study, state.true_posterior
    assert true_posterior is not None
    # Proposals are made, and the law is chosen, by the surrogate where there is one.
    surrogate = state.results.get(Surrogate)
    posterior = study.sampled if surrogate is None else true_posterior.on(surrogate)
    if posterior.costs_runs:  # tens of thousands of runs of somebody's solver
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
    """Choose the sampler for a posterior under another error model."""
    sampler = study.sampler if study.sampler.exact else build_sampler(study.file.sampler)
    named = "sampler" in study.file.model_fields_set
    if posterior.error_model.inside:
        return sampler if named and sampler != SMC() and not _too_few(sampler, posterior) else WITH_HIDDEN_VALUES
    return sampler if named or posterior.error_model.added.independent else FOR_CORRELATED_ERRORS


def _too_few(sampler: Sampler, posterior: Posterior) -> bool:
    """Whether a sampler has too few walkers for the values at the knots."""
    return sampler.interacting and sampler.walkers < 2 * posterior.dimension


def _remark(study: BuiltStudy, posterior: Posterior) -> str:
    """Remark where the study's sampler is replaced."""
    walkers, dimension = build_sampler(study.file.sampler).walkers, posterior.dimension
    return (
        f"The {walkers} walkers of the study's sampler cannot span these {dimension} values, knots included; {2 * dimension} or "
        f"more could. Drawn instead by {WITH_HIDDEN_VALUES.in_words}."
    )


def _wanted(state: StudyState) -> bool:
    study = state.study
    return study.posterior is not None and study.error_model_is_open and study.plan is None


STAGE = StudyStage(ErrorModelChoice, _wanted, _run)
