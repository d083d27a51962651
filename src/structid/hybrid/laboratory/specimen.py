"""The interface of a specimen: it describes itself, moves, holds its position, and refuses what exceeds its limits."""

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
"""Controller steps in one move: a hundred seconds at 1 ms."""


class SpecimenError(StructidError):
    """A specimen refused a move, stopped answering, or its session ended. It holds its position; earlier data are kept.

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

    name: str  # name
    unit: Literal["m", "rad"] = "m"  # unit of its displacement; its force is in N or N m
    # Limits in absolute value [unit], [unit/s] of wall time, [N] or [N m]; None where it has none
    stroke: Positive | None = None
    # Limits in absolute value [unit], [unit/s] of wall time, [N] or [N m]; None where it has none
    velocity: Positive | None = None
    # Limits in absolute value [unit], [unit/s] of wall time, [N] or [N m]; None where it has none
    force: Positive | None = None
    # By which the piston follows its command, as measured by the laboratory [s] of wall time
    delay: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0


class SpecimenDescription(BaseModel):
    """A specimen's description of itself before a test."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str  # name of the specimen
    # What can be moved, in the order of every vector
    channels: Annotated[tuple[SpecimenChannel, ...], Field(min_length=1, max_length=MOST_CHANNELS)]
    controller_step: Positive = 1e-3  # T_c [s] of wall time
    simulated: bool = False  # whether it is a program. A test on a program may be resumed; one on a structure never
    stiffness: tuple[tuple[float, ...], ...] | None = None  # initial stiffness in its channels, if known
    # Where the zero of its channels is, counted from where it was at first; none where it was never zeroed again
    datum: tuple[Finite, ...] | None = None
    # Controller steps that one move may have; 1 for a specimen that makes its own ramps, whose velocity it then sees to
    # itself
    longest_path: Annotated[int, Field(ge=1, le=LONGEST_PATH)] = LONGEST_PATH
    software: str = ""  # software that drives it

    @model_validator(mode="after")
    def _square(self) -> Self:
        if self.stiffness is not None and np.shape(self.stiffness) != (len(self.channels),) * 2:
            raise ValueError(
                f"stiffness has the shape {np.shape(self.stiffness)}, and there are {len(self.channels)} channels"
            )
        if self.datum is not None and len(self.datum) != len(self.channels):
            raise ValueError(f"datum has {len(self.datum)} numbers, and there are {len(self.channels)} channels")
        return self

    def refusal(self, last: Float[np.ndarray, " channel"], path: Float[np.ndarray, "sample channel"]) -> str | None:
        """Explain why a path exceeds the specimen's limits; decided before anything moves."""
        count = len(self.channels)
        if path.ndim != 2 or path.shape[1] != count or not 1 <= len(path) <= self.longest_path:
            return f"a path of shape {path.shape}; it has {count} channels and takes 1 to {self.longest_path} steps"
        if not np.isfinite(path).all():
            return "a command that is not finite"
        rates = np.abs(np.diff(path, axis=0, prepend=last[None])).max(axis=0) / self.controller_step
        for k, channel in enumerate(self.channels):
            farthest = float(np.abs(path[:, k]).max())
            if channel.stroke is not None and farthest > channel.stroke:
                return f"{channel.name}: a displacement of {farthest:.6g} {channel.unit}, and its limit is {channel.stroke:.6g}"
            fastest = None if self.longest_path == 1 else channel.velocity  # its own ramps are its own care
            if fastest is not None and rates[k] > fastest * (1.0 + 1e-9):
                return f"{channel.name}: a velocity of {rates[k]:.6g} {channel.unit}/s, and its limit is {fastest:.6g}"
        return None


class Reading(NamedTuple):
    """Measurements at the end of a move, averaged over its last controller steps."""

    displacement: Float[np.ndarray, " channel"]  # u_m [m]
    force: Float[np.ndarray, " channel"]  # force of the specimen against it [N]


class Specimen(ABC):
    """A structure in a laboratory, or a program in its place.

    It owns its limits. It refuses what exceeds them before it moves, and after an error it holds its last accepted position for
    good: a hysteretic specimen cannot be moved back.

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
        """Say what it is.

        Returns
        -------
        SpecimenDescription
            The same at every call.
        """

    @abstractmethod
    def move(self, path: np.ndarray, averaged: int = 1) -> Reading:
        """Follow a path, and read.

        Parameters
        ----------
        path : ndarray, shape (sample, channel)
            Commands, one a controller step [m].
        averaged : int
            Over how many of the last controller steps the reading is averaged.

        Returns
        -------
        Reading
            Measured displacements and forces.

        Raises
        ------
        SpecimenError
            If it refuses; it then holds its last accepted position.
        """

    @abstractmethod
    def hold(self, reason: str) -> None:
        """Hold the position from now on; a later move is refused.

        Parameters
        ----------
        reason : str
            Why, for its log.
        """

    @abstractmethod
    def close(self) -> None:
        """End the session; it holds its position."""

    def released(self) -> Specimen:
        """The specimen of the next test, after this one's session was closed: unloaded by its operator, and zeroed again.

        Its damage stays. Where its zero is now, it says as the ``datum`` of its description.

        Returns
        -------
        Specimen
            Ready to be moved.

        Raises
        ------
        SpecimenError
            If only its operator can make it ready.
        """
        raise SpecimenError(
            f"'{self.describe().name}' must be unloaded and zeroed by its operator before another test."
        )
