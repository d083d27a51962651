"""The law of the errors, where a study leaves it to the data."""

from __future__ import annotations

from dataclasses import replace

from structid.core.streams import Purpose, derived_seed
from structid.inference.error_model_choice import LawChoice, choose_among
from structid.inference.likelihood.posterior import Posterior
from structid.inference.sampling.base import Sampler
from structid.inference.sampling.smc.smc import SMC
from structid.study.building.built_study import BuiltStudy
from structid.study.building.samplers import build_sampler
from structid.study.folder import LAWS
from structid.study.stages.stage import Findings, StudyStage, Workplace

WITH_HIDDEN_VALUES = SMC(
    particles=500, ensembles=4, steps=250, effective_share=0.5, correlation=0.4, independent=0.2, scouts=0
)
"""Sampler of a study that names none, where parameters drift: the values at the knots are tens of further parameters."""

FOR_CORRELATED_ERRORS = SMC(particles=500, steps=300)
"""The same where errors are correlated: a variance with a heavy tail takes a hundred moves."""


def _run(found: Findings, place: Workplace) -> Findings:
    study, true_posterior = found.study, found.true_posterior
    assert true_posterior is not None
    # Proposals are made, and the law is chosen, by the surrogate where there is one.
    posterior = study.sampled if found.surrogate is None else true_posterior.on(found.surrogate)
    if posterior.costs_runs:  # tens of thousands of runs of somebody's solver
        return found
    what, seed = "choosing the law of the errors", derived_seed(study.file.seed, Purpose.LAW_CHOICE)
    with place.stage(what) as progress, place.timings.measured(what):
        choice = choose_among(posterior, seed=seed, progress=progress, store=place.folder / LAWS)
    return with_law(found, choice)


def with_law(found: Findings, choice: LawChoice) -> Findings:
    """Take the chosen law."""
    study, law = found.study, choice.posterior.law
    assert found.true_posterior is not None
    posterior = study.sampled.on(law=law)
    sampler = sampler_under(study, posterior)
    named = "sampler" in study.file.model_fields_set
    another = sampler is WITH_HIDDEN_VALUES and named and _too_few(build_sampler(study.file.sampler), posterior)
    return replace(
        found,
        law_choice=replace(choice, remark=_remark(study, posterior) if another else ""),
        true_posterior=found.true_posterior.on(law=law),
        study=replace(study, posterior=posterior, sampler=sampler),
    )


def sampler_under(study: BuiltStudy, posterior: Posterior) -> Sampler:
    """Choose the sampler for a posterior under another law."""
    own = study.sampler if study.sampler.exact else build_sampler(study.file.sampler)
    named = "sampler" in study.file.model_fields_set
    if posterior.law.inside:
        return own if named and own != SMC() and not _too_few(own, posterior) else WITH_HIDDEN_VALUES
    return own if named or posterior.law.added.independent else FOR_CORRELATED_ERRORS


def _too_few(own: Sampler, posterior: Posterior) -> bool:
    """Whether a sampler's walkers cannot span the values at the knots."""
    return own.interacting and own.walkers < 2 * posterior.dimension


def _remark(study: BuiltStudy, posterior: Posterior) -> str:
    """What the reader must know where the sampler that the study names is not taken."""
    walkers, dimension = build_sampler(study.file.sampler).walkers, posterior.dimension
    return (
        f"The {walkers} walkers of the study's sampler cannot span these {dimension} values, knots included; {2 * dimension} or "
        f"more could. Drawn instead by {WITH_HIDDEN_VALUES.in_words}."
    )


STAGE = StudyStage(
    lambda found: found.study.posterior is not None and found.study.law_is_open and found.study.plan is None, _run
)
