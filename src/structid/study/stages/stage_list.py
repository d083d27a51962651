"""The stages of a study, in order. To add a stage, add a file with a `StudyStage`, and a line here."""

from __future__ import annotations

from structid.study.stages import (
    campaign_runs,
    certified_calibration,
    deterministic_searches,
    error_model_stage,
    fragility_runs,
    law_stage,
    parameter_runs,
    posterior_draws,
    report_page,
    surrogate_fit,
)
from structid.study.stages.stage import StageTable, StudyStage

STAGES: tuple[StudyStage, ...] = (
    law_stage.STAGE,
    parameter_runs.STAGE,
    campaign_runs.STAGE,
    surrogate_fit.STAGE,
    certified_calibration.STAGE,
    error_model_stage.STAGE,
    deterministic_searches.STAGE,
    posterior_draws.STAGE,
    fragility_runs.STAGE,
)
"""Stages that produce results."""

PAGE_STAGE = report_page.STAGE
"""The stage that writes the page."""


def tables() -> tuple[type[StageTable], ...]:
    """Tables of the study file that belong to a stage."""
    return tuple(stage.table for stage in STAGES if stage.table is not None)
