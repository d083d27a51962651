"""Integration error of a built-in model, from a comparison with shorter steps, and the number of steps it needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.models.finer_steps import in_finer_steps
from structid.models.traceable import TraceableModel

LIMIT = 0.01
"""Error above which shorter steps are recommended, relative to a channel's peak; measurement noise is of this order."""

REFERENCE = 8
"""Number of steps of the reference run, divided by the number of steps of the model."""

TRIED = (2, 4)
"""Factors by which the number of steps is multiplied, in turn, if the model's steps are too long."""


@dataclass(frozen=True)
class IntegrationError:
    """Integration error of one run."""

    setting: str  # name of the setting, such as ``"substeps"``
    steps: int  # value of the setting
    # Largest difference from a run with eight times as many steps, as a fraction of the channel's peak; infinite if the
    # run fails
    error: float
    # Value of the setting with an error below the limit; None if eight times as many steps are still not accurate
    wanted: int | None

    @property
    def too_large(self) -> bool:
        """Whether shorter steps are recommended."""
        return not self.error <= LIMIT

    def __str__(self) -> str:
        by = f"With {self.setting} = {self.steps} the integration"
        if np.isfinite(self.error):
            return f"{by} error is {100.0 * self.error:.2g} % of the peak."
        return f"{by} steps are too long for the stiffness or the hysteretic law."

    @property
    def question(self) -> str:
        """Recommendation; empty if the error is small."""
        if not self.too_large:
            return ""
        if self.wanted is None:
            return f"{self} Even {REFERENCE * self.steps} steps are not enough. Check priors, units and time step."
        return f"{self} For an error below {100.0 * LIMIT:g} %, set {self.setting} = {self.wanted} in [model]."


def integration_error(
    model: TraceableModel, theta: Float[np.ndarray, "1 parameter"], excitation: Excitation
) -> IntegrationError | None:
    """Compare a run with the same run in shorter steps, and find a sufficient number of steps."""
    setting = model.steps_setting
    if not setting:
        return None

    def error_of(run: Histories) -> float:
        if not (run.done[0] and exact.done[0]):
            return float("inf")
        peaks = np.abs(exact.values[0]).max(axis=0)
        return float((np.abs(run.values[0] - exact.values[0]).max(axis=0) / np.where(peaks > 0.0, peaks, 1.0)).max())

    steps = int(getattr(model, setting))
    exact = in_finer_steps(model, REFERENCE).simulate(theta, excitation)
    error = error_of(model.simulate(theta, excitation))
    if error <= LIMIT:
        return IntegrationError(setting, steps, error, steps)
    if not exact.done[0]:
        return IntegrationError(setting, steps, error, None)
    enough = (times for times in TRIED if error_of(in_finer_steps(model, times).simulate(theta, excitation)) <= LIMIT)
    return IntegrationError(setting, steps, error, next(enough, REFERENCE) * steps)
