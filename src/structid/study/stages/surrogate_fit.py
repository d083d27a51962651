"""Stage: fit the surrogate of a study to model runs, validate it on other runs, and replace the model by it."""

from __future__ import annotations

from dataclasses import replace

from structid.campaign.runner import Campaign
from structid.campaign.runs import Runs
from structid.core.errors import InputError
from structid.core.streams import Purpose, derived_seed
from structid.study.building.built_study import BuiltStudy
from structid.study.building.surrogates import fitted_surrogate
from structid.study.folder_layout import SURROGATE
from structid.study.stages.report_page import write_runs_page
from structid.study.stages.stage import StudyStage, StudyState, Workplace
from structid.surrogates.base import Surrogate

VALIDATION = "validation.h5"
"""Model runs that validate the surrogate."""


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    study, runs = state.study, state.results[Runs]
    with (
        workplace.stage("fitting the surrogate") as progress,
        workplace.timings.measured("fitting the surrogate", once=True),
    ):
        surrogate = fitted_surrogate(study.file.surrogate, runs, workplace.folder / SURROGATE, progress)
    if surrogate.validation is None:
        _validate(surrogate, study, workplace)
        surrogate.save(workplace.folder / SURROGATE)
    return _in_its_place(state.having(Surrogate, surrogate), surrogate, workplace)


def _validate(surrogate: Surrogate, study: BuiltStudy, workplace: Workplace) -> None:
    """Compare the surrogate with model runs that were not used in its fit."""
    # A separate random stream: the training design may be random with the same seed.
    seed = derived_seed(study.file.seed, Purpose.VALIDATION_DESIGN)
    design = study.space.sample(study.validation_runs, seed, "random")
    campaign = Campaign(study.model, study.campaign_records, design, workplace.folder / VALIDATION, assignment="cycle")
    what = "model runs to validate it"
    with workplace.stage(what) as progress, workplace.timings.measured(what, goes_on=True):
        unseen = campaign.run(workplace.executor, progress=progress)
    what = "validating the surrogate"
    with workplace.stage(what) as progress, workplace.timings.measured(what):
        surrogate.validate(unseen, progress)


def _in_its_place(state: StudyState, surrogate: Surrogate, workplace: Workplace) -> StudyState:
    """Replace the model by the surrogate in the sampling, or use the surrogate for proposals."""
    study = state.study
    if study.posterior is None:
        return state
    if study.sampler.exact:
        return replace(state, study=replace(study, sampler=study.sampler.proposing_by(surrogate)))
    try:
        return replace(state, study=replace(study, posterior=study.posterior.on(surrogate)))
    except InputError:
        write_runs_page(state, workplace)  # so that the user can inspect the validation
        raise


STAGE = StudyStage(Surrogate, lambda state: state.study.has_surrogate and state.study.plan is None, _run)
