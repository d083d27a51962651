"""Stage: a calibration with a surrogate, certified by model runs."""

from __future__ import annotations

import warnings
from dataclasses import replace

from structid.calibration.calibration_result import CalibrationResult
from structid.calibration.sequential import calibrate
from structid.campaign.store import CALIBRATION_FOLDER
from structid.core.errors import UnlikeMeasuredWarning
from structid.inference.error_model_choice import AUTO
from structid.report.material.material import calibration_results
from structid.study.building.surrogates import surrogate_settings
from structid.study.stages.stage import StudyStage, StudyState, Workplace
from structid.study.timings import StepProgress


def _run(state: StudyState, workplace: Workplace) -> StudyState:
    study, posterior, true_posterior = state.study, state.study.sampled, state.true_posterior
    with StepProgress(workplace.stage, workplace.timings) as report, warnings.catch_warnings():
        if study.model.batched:
            warnings.simplefilter("ignore", UnlikeMeasuredWarning)  # `plausibility` has already reported these warnings
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
    if true_posterior is not None:
        true_posterior = true_posterior.on(error_model=calibration.posterior.error_model)
    return replace(
        state, study=study, true_posterior=true_posterior, results=state.results | calibration_results(calibration)
    )


STAGE = StudyStage(CalibrationResult, lambda state: state.study.plan is not None, _run)
