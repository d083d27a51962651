"""The surrogate that a study asks for: fitted to its true runs, validated on others, put in the model's place."""

from __future__ import annotations

from dataclasses import replace

from structid.campaign.runner import Campaign
from structid.core.errors import InputError
from structid.core.streams import Purpose, derived_seed
from structid.study.building.built_study import BuiltStudy
from structid.study.building.surrogates import fitted_surrogate
from structid.study.folder import SURROGATE, VALIDATION
from structid.study.stages.report_page import write_runs_page
from structid.study.stages.stage import Findings, StudyStage, Workplace
from structid.surrogates.base import Surrogate


def _run(found: Findings, place: Workplace) -> Findings:
    study = found.study
    assert found.runs is not None
    with place.stage("fitting the surrogate") as progress, place.timings.measured("fitting the surrogate", once=True):
        surrogate = fitted_surrogate(study.file.surrogate, found.runs, place.folder / SURROGATE, progress)
    if surrogate.validation is None:
        _validate(surrogate, study, place)
        surrogate.save(place.folder / SURROGATE)
    return _in_its_place(replace(found, surrogate=surrogate), surrogate, place)


def _validate(surrogate: Surrogate, study: BuiltStudy, place: Workplace) -> None:
    """Compare it with true runs that it has not seen."""
    # A stream of its own: the design may be a random one of the same seed.
    seed = derived_seed(study.file.seed, Purpose.VALIDATION_DESIGN)
    design = study.space.sample(study.validation_runs, seed, "random")
    campaign = Campaign(study.model, study.campaign_records, design, place.folder / VALIDATION, assignment="cycle")
    what = "true runs to validate it"
    with place.stage(what) as progress, place.timings.measured(what, goes_on=True):
        unseen = campaign.run(place.executor, progress=progress)
    what = "validating the surrogate"
    with place.stage(what) as progress, place.timings.measured(what):
        surrogate.validate(unseen, progress)


def _in_its_place(found: Findings, surrogate: Surrogate, place: Workplace) -> Findings:
    """The study that samples the surrogate, or lets it make proposals."""
    study = found.study
    if study.posterior is None:
        return found
    if study.sampler.exact:
        return replace(found, study=replace(study, sampler=study.sampler.proposing_by(surrogate)))
    try:
        return replace(found, study=replace(study, posterior=study.posterior.on(surrogate)))
    except InputError:
        write_runs_page(found, place)  # so that its validation can be looked at
        raise


STAGE = StudyStage(lambda found: found.study.has_surrogate and found.study.plan is None, _run)
