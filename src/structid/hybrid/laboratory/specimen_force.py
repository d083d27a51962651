"""The restoring force of a specimen, which is moved along compensated paths and read at their ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.hybrid.control.compensation import Compensator
from structid.hybrid.control.motion import Motion
from structid.hybrid.laboratory.specimen import Reading, Specimen, SpecimenError
from structid.mechanics.restoring_forces import RestoringForce

TARE = 1.0
"""Wall time over which the force at rest is averaged [s]."""


class Move(NamedTuple):
    """One move of a specimen, and the reading at its end; arrays (channel,)."""

    target: np.ndarray  # target from the integrator [m]
    command: np.ndarray  # last command [m]
    measured: np.ndarray  # measured displacement [m]
    force: np.ndarray  # force of the specimen, minus its force before the test [N]


class SpecimenForce(RestoringForce):
    """Restoring force r(u) = Bᵀ F of a specimen whose channels move by B u.

    Each displacement is imposed once, and its force is read once. The force before the first move belongs to the static load and
    is subtracted from every reading.
    """

    def __init__(
        self,
        specimen: Specimen,
        geometry: Float[np.ndarray, "channel dof"],
        motion: Motion,
        compensator: Compensator | None = None,
        stiffness: Float[np.ndarray, "dof dof"] | None = None,
        moved: Callable[[Move], None] | None = None,
    ) -> None:
        self.specimen, self.geometry, self.motion = specimen, geometry, motion
        self.compensator, self.stiffness, self.moved = compensator, stiffness, moved
        self._target = np.zeros(len(geometry))
        self._at_rest: np.ndarray | None = None
        if stiffness is not None:
            self._back = np.linalg.pinv(geometry)

    @property
    def dofs(self) -> int:
        """Number of degrees of freedom of the physical part."""
        return int(self.geometry.shape[1])

    def at_rest(self, displacement: Float[Array, "dof *run"]) -> Any:
        """Return an empty memory, because the specimen keeps its own state; see `RestoringForce.at_rest`."""
        return ()

    def begin(self, displacement: Float[Array, "dof *run"]) -> tuple[Any, Any]:
        """Read the specimen at its initial position; see `RestoringForce.begin`."""
        return self.at(self.at_rest(displacement), displacement)

    def at(self, memory: Any, displacement: Float[Array, "dof *run"]) -> tuple[Any, Any]:
        """Move the specimen; see `RestoringForce.at`."""
        if self._at_rest is None:
            self._at_rest = self._tared()
        target = self.geometry @ displacement
        path = self.motion.path(self._target, target)
        commands = path if self.compensator is None else self.compensator.commands(path)
        reading = self._checked(self.specimen.move(commands, self.motion.averaged))
        if self.compensator is not None:
            self.compensator.observe(commands[-1:], reading.displacement[None])
        self._target, force = target, reading.force - self._at_rest
        if self.moved is not None:
            self.moved(Move(target, commands[-1], reading.displacement, force))
        restoring = self.geometry.T @ force
        if self.stiffness is not None:
            restoring = restoring + self.stiffness @ (self._back @ (target - reading.displacement))
        return restoring, memory

    def _tared(self) -> np.ndarray:
        """Return the force before the first move, averaged over a long time because all readings are relative to it."""
        step = self.specimen.describe().controller_step
        count = min(max(round(TARE / step), 1), self.specimen.describe().longest_path)
        return self._checked(self.specimen.move(np.zeros((count, len(self.geometry))), count)).force

    @staticmethod
    def _checked(reading: Reading) -> Reading:
        if not (np.isfinite(reading.displacement).all() and np.isfinite(reading.force).all()):
            raise SpecimenError("The reading of the specimen is not finite.")
        return reading
