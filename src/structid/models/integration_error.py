"""Integration error of a built-in model, from the same run with shorter steps, and the number of steps that suffices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.models.traceable import TraceableModel

LIMIT = 0.01
"""Error, relative to a channel's peak, above which shorter steps are recommended; measurement noise is of this order."""

REFERENCE = 8
"""Factor on the number of steps for the reference run."""

TRIED = (2, 4)
"""Factors on the number of steps that are tried in turn where the model's steps are too long."""


@dataclass(frozen=True)
class IntegrationError:
    """Integration error of one run."""

    setting: str  # name of the setting, such as ``"substeps"``
    steps: int  # its value
    # Largest difference from a run with eight times as many, in parts of the peak of the channel; infinite where the
    # run fails
    error: float
    # The value with which the error is below the limit; None where even eight times as many steps do not follow the law
    wanted: int | None

    @property
    def too_large(self) -> bool:
        """Whether shorter steps are recommended."""
        return not self.error <= LIMIT

    def __str__(self) -> str:
        by = f"With {self.setting} = {self.steps} the integration"
        if np.isfinite(self.error):
            return f"{by} errs by {100.0 * self.error:.2g} % of the peak."
        return f"{by} does not follow the stiffness or the hysteretic law."

    @property
    def question(self) -> str:
        """Recommendation; empty where the error is small."""
        if not self.too_large:
            return ""
        if self.wanted is None:
            return f"{self} Nor does {REFERENCE * self.steps}. Are priors, units and time step right?"
        return f"{self} {self.setting} = {self.wanted} in [model] brings it below {100.0 * LIMIT:g} %."


def _finer(model: Any, times: int) -> TraceableModel:
    """The same model with a multiple of its steps."""
    finer: TraceableModel = replace(model, **{model.steps_setting: times * getattr(model, model.steps_setting)})
    return finer


def integration_error(
    model: TraceableModel, theta: Float[np.ndarray, "1 parameter"], excitation: Excitation
) -> IntegrationError | None:
    """Compare a run with the same run in shorter steps."""
    setting = model.steps_setting
    if not setting:
        return None

    def error_of(run: Histories) -> float:
        if not (run.done[0] and exact.done[0]):
            return float("inf")
        peaks = np.abs(exact.values[0]).max(axis=0)
        return float((np.abs(run.values[0] - exact.values[0]).max(axis=0) / np.where(peaks > 0.0, peaks, 1.0)).max())

    steps = int(getattr(model, setting))
    exact = _finer(model, REFERENCE).simulate(theta, excitation)
    error = error_of(model.simulate(theta, excitation))
    if error <= LIMIT:
        return IntegrationError(setting, steps, error, steps)
    if not exact.done[0]:
        return IntegrationError(setting, steps, error, None)
    enough = (times for times in TRIED if error_of(_finer(model, times).simulate(theta, excitation)) <= LIMIT)
    return IntegrationError(setting, steps, error, next(enough, REFERENCE) * steps)
