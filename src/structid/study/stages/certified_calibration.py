"""Stage: a calibration with a surrogate that model runs certify."""

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


def _run(findings: Findings, workplace: Workplace) -> Findings:
    study, posterior = findings.study, findings.study.sampled
    with StagesAsTold(workplace.stage, workplace.timings) as report, warnings.catch_warnings():
        if study.model.batched:
            warnings.simplefilter("ignore", UnlikeMeasuredWarning)  # asked before the study ran; see `plausibility`
        calibration = calibrate(
            study.model,
            posterior.model_space,
            posterior.observations,
            surrogate_settings(study.file.surrogate),
            AUTO if study.error_model_is_open else posterior.error_model,
            plan=study.plan,
            sampler=study.sampler if "sampler" in study.file.model_fields_set else None,
            seed=study.file.seed,
            store=workplace.folder / CALIBRATION_FOLDER,
            adopt=workplace.adopt,
            executor=workplace.executor,
            progress=report,
        )
    if not calibration.exact:
        study = replace(study, posterior=calibration.posterior.on(calibration.surrogate))
    else:
        study = replace(study, posterior=calibration.posterior)
    return replace(
        findings,
        study=study,
        runs=calibration.runs,
        surrogate=calibration.surrogate,
        calibration=calibration,
        law_choice=calibration.law_choice,
        true_posterior=None
        if findings.true_posterior is None
        else findings.true_posterior.on(error_model=calibration.posterior.error_model),
        result=calibration.sampling,
    )


STAGE = StudyStage(lambda found: found.study.plan is not None, _run)
