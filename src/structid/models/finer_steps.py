"""Runs under excitations that are stronger than those of a calibration: shorter integration steps where these are needed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.progress import Progress
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.models.base import Map, Model
from structid.models.traceable import TraceableModel

FINER = (2, 4, 8, 16)
"""Factors by which the number of steps is multiplied, in turn, until the runs succeed."""


def in_finer_steps(model: Any, times: int) -> TraceableModel:
    """Return the same model with `times` as many integration steps; the model itself, with its compiled loops, for one."""
    if times == 1 and isinstance(model, TraceableModel):
        return model
    finer: TraceableModel = replace(model, **{model.steps_setting: times * getattr(model, model.steps_setting)})
    return finer


def simulate_in_steps_it_needs(
    model: Model,
    theta: Float[np.ndarray, "run parameter"],
    excitation: Excitation,
    progress: Progress | None = None,
    map: Map | None = None,
) -> Histories:
    """Simulate runs, and repeat those that fail in shorter steps; a model without a setting for them is simulated once.

    The steps of a model are enough for the measured motion. A stronger one moves a spring farther in each step.
    """
    runs = model.simulate(theta, excitation, progress=progress, map=map)
    if runs.done.all() or not (isinstance(model, TraceableModel) and model.steps_setting):
        return runs
    for times in FINER:
        failed = np.flatnonzero(~runs.done)
        runs = _with_rows(runs, failed, in_finer_steps(model, times).simulate(theta[failed], excitation))
        if runs.done.all():
            break
    return runs


def _with_rows(runs: Histories, places: np.ndarray, others: Histories) -> Histories:
    """Return runs with other runs in some places."""
    values, status, time = runs.values.copy(), runs.status.copy(), runs.failure_time.copy()
    values[places], status[places], time[places] = others.values, others.status, others.failure_time
    reasons = list(runs.reasons)
    for place, reason in zip(places, others.reasons, strict=True):
        reasons[place] = reason
    return replace(runs, values=values, status=status, failure_time=time, reasons=tuple(reasons))
