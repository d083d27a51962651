"""Interface of a specimen: it describes itself, moves, refuses paths beyond its limits, and holds its position."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

from structid.core.errors import StructidError

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
MOST_CHANNELS = 64
LONGEST_PATH = 100_000
"""Largest number of controller steps in one move: a hundred seconds at 1 ms."""


class SpecimenError(StructidError):
    """A specimen refused a move or stopped answering, or a session ended. It holds its position; earlier data are kept.

    Examples
    --------
    >>> import structid as si
    >>> try:
    ...     result = test.run("test_1.h5")  # doctest: +SKIP
    ... except si.SpecimenError as refusal:  # the steps before it are in the file
    ...     print(refusal)
    """


class SpecimenChannel(BaseModel):
    """One actuated displacement of a specimen."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str  # name of the channel
    unit: Literal["m", "rad"] = "m"  # unit of its displacement; its force is in N or N m
    stroke: Positive | None = None  # largest absolute displacement [unit]; None for no limit
    velocity: Positive | None = None  # largest absolute velocity [unit/s] of wall time; None for no limit
    force: Positive | None = None  # largest absolute force [N] or [N m]; None for no limit
    # Delay of the piston relative to its command, as measured by the laboratory [s] of wall time
    delay: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0


class SpecimenDescription(BaseModel):
    """Description of a specimen, which it sends before a test."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str  # name of the specimen
    # Channels that can be moved, in the order of all vectors
    channels: Annotated[tuple[SpecimenChannel, ...], Field(min_length=1, max_length=MOST_CHANNELS)]
    controller_step: Positive = 1e-3  # T_c [s] of wall time
    simulated: bool = False  # whether it is a program; a test on a structure is never resumed
    stiffness: tuple[tuple[float, ...], ...] | None = None  # initial stiffness of the channels, if known
    # Present zero of the channels, relative to their first zero; None if it was never reset
    datum: tuple[Finite, ...] | None = None
    # Largest number of controller steps of a move; 1 for a specimen that generates its own ramps and limits their velocity
    longest_path: Annotated[int, Field(ge=1, le=LONGEST_PATH)] = LONGEST_PATH
    software: str = ""  # software that drives it

    @model_validator(mode="after")
    def _square(self) -> Self:
        if self.stiffness is not None and np.shape(self.stiffness) != (len(self.channels),) * 2:
            raise ValueError(
                f"stiffness has the shape {np.shape(self.stiffness)}, but there are {len(self.channels)} channels"
            )
        if self.datum is not None and len(self.datum) != len(self.channels):
            raise ValueError(f"datum has {len(self.datum)} numbers, but there are {len(self.channels)} channels")
        return self

    def refusal(self, last: Float[np.ndarray, " channel"], path: Float[np.ndarray, "sample channel"]) -> str | None:
        """Return the reason to refuse a path before any movement, or None if it is within the specimen's limits."""
        count = len(self.channels)
        if path.ndim != 2 or path.shape[1] != count or not 1 <= len(path) <= self.longest_path:
            return f"a path of shape {path.shape} does not have {count} channels and 1 to {self.longest_path} steps"
        if not np.isfinite(path).all():
            return "a command is not finite"
        rates = np.abs(np.diff(path, axis=0, prepend=last[None])).max(axis=0) / self.controller_step
        for k, channel in enumerate(self.channels):
            farthest = float(np.abs(path[:, k]).max())
            if channel.stroke is not None and farthest > channel.stroke:
                return f"{channel.name}: a displacement of {farthest:.6g} {channel.unit} exceeds its limit of {channel.stroke:.6g}"
            fastest = None if self.longest_path == 1 else channel.velocity  # it limits the velocity of its own ramps
            if fastest is not None and rates[k] > fastest * (1.0 + 1e-9):
                return (
                    f"{channel.name}: a velocity of {rates[k]:.6g} {channel.unit}/s exceeds its limit of {fastest:.6g}"
                )
        return None


class Reading(NamedTuple):
    """Measurements at the end of a move, averaged over its last controller steps."""

    displacement: Float[np.ndarray, " channel"]  # u_m [m]
    force: Float[np.ndarray, " channel"]  # reaction force of the specimen [N]


class Specimen(ABC):
    """A structure in a laboratory, or a program in its place.

    A specimen has its own limits, and refuses a path beyond them before any movement. After an error, it holds its last accepted
    position permanently, because a hysteretic specimen cannot return to an earlier state.

    Examples
    --------
    >>> import structid as si
    >>> class Bench(si.Specimen):  # doctest: +SKIP
    ...     def describe(self):
    ...         return description
    ...     def move(self, path, averaged=1):
    ...         return controller.follow(path, averaged)
    ...     def hold(self, reason):
    ...         controller.stop(reason)
    ...     def close(self):
    ...         controller.close()
    """

    @abstractmethod
    def describe(self) -> SpecimenDescription:
        """Description of the specimen.

        Returns
        -------
        SpecimenDescription
            The same description at every call.
        """

    @abstractmethod
    def move(self, path: np.ndarray, averaged: int = 1) -> Reading:
        """Follow a path, and read the sensors at its end.

        Parameters
        ----------
        path : ndarray, shape (sample, channel)
            Commands, one per controller step [m].
        averaged : int
            Number of final controller steps over which the reading is averaged.

        Returns
        -------
        Reading
            Measured displacements and forces.

        Raises
        ------
        SpecimenError
            If the specimen refuses the path; it then holds its last accepted position.
        """

    @abstractmethod
    def hold(self, reason: str) -> None:
        """Hold the position from now on; a later move is refused.

        Parameters
        ----------
        reason : str
            Reason, for the log of the specimen.
        """

    @abstractmethod
    def close(self) -> None:
        """End the session; the specimen holds its position."""

    def released(self) -> Specimen:
        """Return the specimen for the next test, unloaded and zeroed after its session was closed.

        Its damage remains. The ``datum`` of its description gives the new zero.

        Returns
        -------
        Specimen
            Specimen that is ready to move.

        Raises
        ------
        SpecimenError
            If only an operator can unload and zero the specimen.
        """
        raise SpecimenError(
            f"'{self.describe().name}' must be unloaded and zeroed by its operator before another test."
        )
