"""Motion of a specimen in wall time: ramp and hold, or continuous, one value per controller step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError

LEAST_OF_A_RAMP = 5
"""Minimum number of controller steps of a ramp and hold."""
ROUNDING = 1e-6
"""Tolerance for a number of controller steps that must be an integer."""


@dataclass(frozen=True)
class Motion:
    """Motion of a specimen during one step."""

    samples: int  # number of controller steps
    ramp: int  # number of controller steps of the ramp; a hold follows
    averaged: int  # number of final controller steps over which the reading is averaged
    # Whether the specimen generates its own ramp and answers on arrival; it then receives one position per move
    settles: bool = False

    @property
    def continuous(self) -> bool:
        """True if the motion never stops."""
        return self.ramp == self.samples and not self.settles

    def path(
        self, start: Float[np.ndarray, " channel"], end: Float[np.ndarray, " channel"]
    ) -> Float[np.ndarray, "sample channel"]:
        """Return the target at each controller step of a move."""
        share = np.minimum(np.arange(1, self.samples + 1) / self.ramp, 1.0)
        if not self.continuous:
            share = share**2 * (3.0 - 2.0 * share)
        return np.asarray(start + share[:, None] * (end - start))

    @property
    def peak_rate(self) -> float:
        """Largest fraction of a move in one controller step; in a smooth ramp, about 1.5 times the mean."""
        return float(np.abs(np.diff(self.path(np.zeros(1), np.ones(1)), axis=0, prepend=0.0)).max())


def controller_steps(wall_time: float, controller_step: float, what: str) -> int:
    """Return the number of controller steps in an interval of wall time."""
    count = wall_time / controller_step
    if round(count) < 1 or abs(count - round(count)) > ROUNDING * max(count, 1.0):
        raise InputError(
            what,
            f"{wall_time:g} s of wall time, or {count:g} controller steps of {controller_step:g} s",
            "a whole number of controller steps, one or more",
            "Change the time scale, the step or the number of substeps.",
        )
    return round(count)


def continuous_motion(wall_time: float, controller_step: float) -> Motion:
    """Return a motion without a hold, for a specimen on the fine step."""
    count = controller_steps(wall_time, controller_step, "a fine step of the specimen")
    return Motion(count, count, 1)


ITS_OWN_RAMP = Motion(1, 1, 1, settles=True)
"""Motion of a specimen that accepts one position per move."""


def ramp_and_hold(wall_time: float, controller_step: float, share: float = 0.8) -> Motion:
    """Return a motion with a ramp and a hold, for a specimen on the coarse step."""
    count = controller_steps(wall_time, controller_step, "a step of the specimen")
    if count < LEAST_OF_A_RAMP:
        came = f"{wall_time:g} s of wall time, or {count} controller steps"
        raise InputError(
            "a step of the specimen",
            came,
            f"{LEAST_OF_A_RAMP} or more controller steps for a ramp and a hold",
            "Choose a larger time scale.",
        )
    ramp = min(max(round(share * count), 1), count - 1)
    return Motion(count, ramp, max((count - ramp) // 2, 1))
