"""The law of the errors, where a study leaves it to the data."""

from __future__ import annotations

from dataclasses import replace

from structid.inference.law_choice import LawChoice, choose_among
from structid.inference.sampling.tempered import SMC
from structid.streams import Purpose, derived_seed
from structid.study.building.samplers import build_sampler
from structid.study.folder import LAWS
from structid.study.stages.stage import Findings, StudyStage, Workplace

WITH_HIDDEN_VALUES = SMC(
    particles=500, ensembles=4, steps=250, effective_share=0.5, correlation=0.4, independent=0.2, scouts=0
)
"""Sampler of a study that names none, where parameters drift: the values at the knots are tens of further parameters."""


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
    """Take the chosen law.

    Parameters
    ----------
    found : Findings
        With posteriors under another law.
    choice : LawChoice
        The choice.

    Returns
    -------
    Findings
        With posteriors under the chosen one, and a sampler for its hidden values where the study names none.
    """
    study, law = found.study, choice.posterior.law
    assert found.true_posterior is not None
    sampler = study.sampler
    if "sampler" not in study.file.model_fields_set:
        sampler = WITH_HIDDEN_VALUES if law.inside else build_sampler(study.file.sampler)
    return replace(
        found,
        law_choice=choice,
        true_posterior=found.true_posterior.on(law=law),
        study=replace(study, posterior=study.sampled.on(law=law), sampler=sampler),
    )


STAGE = StudyStage(
    lambda found: found.study.posterior is not None and found.study.law_is_open and found.study.plan is None, _run
)
