"""A calibration by a surrogate that true runs certify."""

from __future__ import annotations

import warnings
from dataclasses import replace

from structid.calibration.sequential import calibrate
from structid.campaign.store import CALIBRATION_FOLDER
from structid.core.errors import UnlikeMeasuredWarning
from structid.inference.error_model_choice import AUTO
from structid.study.building.surrogates import surrogate_settings
from structid.study.stages.stage import Findings, StudyStage, Workplace
from structid.study.timings import StagesAsTold


def _run(found: Findings, place: Workplace) -> Findings:
    study, posterior = found.study, found.study.sampled
    with StagesAsTold(place.stage, place.timings) as told, warnings.catch_warnings():
        if study.model.batched:
            warnings.simplefilter("ignore", UnlikeMeasuredWarning)  # asked before the study ran; see `plausibility`
        calibration = calibrate(
            study.model,
            posterior.model_space,
            posterior.observations,
            surrogate_settings(study.file.surrogate),
            AUTO if study.law_is_open else posterior.law,
            plan=study.plan,
            sampler=study.sampler if "sampler" in study.file.model_fields_set else None,
            seed=study.file.seed,
            store=place.folder / CALIBRATION_FOLDER,
            adopt=place.adopt,
            executor=place.executor,
            progress=told,
        )
    if not calibration.exact:
        study = replace(study, posterior=calibration.posterior.on(calibration.surrogate))
    else:
        study = replace(study, posterior=calibration.posterior)
    return replace(
        found,
        study=study,
        runs=calibration.runs,
        surrogate=calibration.surrogate,
        calibration=calibration,
        law_choice=calibration.law_choice,
        true_posterior=None if found.true_posterior is None else found.true_posterior.on(law=calibration.posterior.law),
        result=calibration.sampling,
    )


STAGE = StudyStage(lambda found: found.study.plan is not None, _run)
