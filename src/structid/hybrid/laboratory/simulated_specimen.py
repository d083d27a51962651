"""A simulated specimen: hysteretic springs or a wall, behind actuators and sensors."""

from __future__ import annotations

import time
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.hybrid.control.transfer_system import CONTROLLER_STEP, Actuator, TransferSystem
from structid.hybrid.laboratory.specimen import Reading, Specimen, SpecimenChannel, SpecimenDescription, SpecimenError
from structid.mechanics.restoring_forces import CollapseError, RestoringForce

RELEASED = 1e-7
"""Largest force of an unloaded specimen, relative to its peak force."""
MOST_RELEASES = 2000
"""Largest number of moves to unload a specimen."""


@check_arguments
class SimulatedSpecimen(Specimen):
    """A restoring force behind a transfer system, with the limits of its actuators.

    Parameters
    ----------
    structure : RestoringForce
        Restoring force of the structure, whose degrees of freedom are the channels.
    actuators : Actuator or sequence of Actuator
        One actuator for all channels, or one actuator per channel.
    channels : sequence of str
        Names of the channels.
    units : sequence of str, optional
        Unit of each channel, ``"m"`` or ``"rad"``; default: metres.
    stiffness : array-like, shape (channel, channel), optional
        Initial stiffness, if the description of the specimen contains it.
    controller_step : float
        Controller step T_c [s].
    seed : int
        Seed of the sensor noise.
    name : str
        Name of the specimen.
    real_time : bool
        Whether a move takes its real time, as in a laboratory.

    Examples
    --------
    >>> import structid as si
    >>> frame = si.ShearFrame(storeys=2, mass=12e3, stiffness=7.6e6, alpha=0.05, beta=63.0, gamma=63.0, damping_ratio=0.03)
    >>> upper, lower = si.cut_frame(frame, 1)
    >>> specimen = si.SimulatedSpecimen(lower.force, si.Actuator(delay=0.012, stroke=0.1))
    >>> specimen.describe().channels[0].name
    'displacement'
    """

    def __init__(
        self,
        structure: RestoringForce,
        actuators: Actuator | Sequence[Actuator] | None = None,
        *,
        channels: Sequence[str] = ("displacement",),
        units: Sequence[str] | None = None,
        stiffness: np.ndarray | None = None,
        controller_step: float = CONTROLLER_STEP,
        seed: int = 0,
        name: str = "simulated specimen",
        real_time: bool = False,
    ) -> None:
        names = (channels,) if isinstance(channels, str) else tuple(channels)
        one = Actuator() if actuators is None else actuators
        each = (one,) * len(names) if isinstance(one, Actuator) else tuple(one)
        if len(each) != len(names):
            raise InputError(
                "SimulatedSpecimen.actuators", f"{len(each)} actuators", f"1 for all channels, or {len(names)}"
            )
        self.structure, self.real_time = structure, real_time
        self._seed, self._transfer = seed, TransferSystem(each, controller_step, seed)
        self._description = SpecimenDescription(
            name=name,
            channels=tuple(
                SpecimenChannel(
                    name=channel,
                    unit="rad" if unit == "rad" else "m",
                    stroke=a.stroke,
                    velocity=a.velocity,
                    force=a.force,
                    delay=a.delay + (max(a.lag - 0.5 * controller_step, 0.0) if a.lag else 0.0),
                )
                for channel, unit, a in zip(names, units or ("m",) * len(names), each, strict=True)
            ),
            controller_step=controller_step,
            simulated=True,
            stiffness=None if stiffness is None else tuple(map(tuple, np.asarray(stiffness, dtype=float).tolist())),
            software="structid",
        )
        nothing = np.zeros(len(names))
        self._memory = structure.at_rest(nothing)
        self._force, self._memory = structure.at(self._memory, nothing)
        self._static, self._largest = self._force, 0.0
        self._datum, self._place, self._command = nothing, nothing, nothing
        self._held = ""

    def describe(self) -> SpecimenDescription:
        """Description of the specimen; see `Specimen.describe`."""
        return self._description

    def move(self, path: np.ndarray, averaged: int = 1) -> Reading:
        """Follow a path; see `Specimen.move`."""
        began = time.perf_counter()
        if self._held:
            raise SpecimenError(
                f"The specimen holds its position: {self._held}. End the test and inspect the specimen; tests are never resumed."
            )
        path = np.asarray(path, dtype=np.float64)
        if refusal := self._description.refusal(self._command, path):
            self.hold(refusal)
            raise SpecimenError(f"The move was refused before it started: {refusal}.")
        places = self._transfer.followed(path)
        self._command = path[-1]
        last = max(len(places) - averaged, 0)
        try:
            forces = self._forces(self._datum + places, last)
        except CollapseError as collapse:
            self.hold(f"the structure has failed: {collapse}")
            raise SpecimenError(f"The structure has failed: {collapse}") from None
        displacement, force = (x.mean(axis=0) for x in self._transfer.seen(places[last:], forces))
        for k, channel in enumerate(self._description.channels):
            if channel.force is not None and abs(force[k]) > channel.force:
                self.hold(f"{channel.name}: a force of {force[k]:.6g} N exceeds its limit of {channel.force:.6g}")
                raise SpecimenError(f"The specimen stopped at its position: {self._held}.")
        if self.real_time:
            time.sleep(max(len(path) * self._description.controller_step - (time.perf_counter() - began), 0.0))
        return Reading(displacement, force)

    def _forces(self, places: np.ndarray, last: int) -> np.ndarray:
        """Follow the whole path, and return the forces at its positions from index `last` on.

        A rate-independent structure depends on the turning points of its path, not on every controller step. It moves only to
        turning points, to positions `largest_move` apart, and to both ends of the averaged range; forces between them are
        interpolated.
        """
        kept = self._kept(np.concatenate([self._place[None], places]), last)
        forces = []
        for index in kept:
            self._impose(places[index])
            forces.append(self._force)
        indices, stops = np.arange(last, len(places)), np.array(kept)
        within = stops >= last
        return np.stack(
            [np.interp(indices, stops[within], np.array(forces)[within, k]) for k in range(places.shape[1])], axis=1
        )

    def _impose(self, place: np.ndarray) -> None:
        """Move the structure to a position."""
        self._force, self._memory = self.structure.at(self._memory, place)
        self._place = place
        self._largest = max(self._largest, float(np.abs(self._force - self._static).max()))

    def _kept(self, places: np.ndarray, last: int) -> list[int]:
        """Return the indices of the positions to which the structure moves; index 0 is the second row of `places`."""
        steps = np.diff(places, axis=0)
        turns = np.any(np.sign(steps[1:]) * np.sign(steps[:-1]) < 0.0, axis=1)
        far = np.floor(np.cumsum(np.abs(steps).max(axis=1)) / self.structure.largest_move)
        passes = np.diff(far, prepend=0.0) > 0.0
        passes[:-1] |= turns
        passes[[last, -1]] = True
        return [int(k) for k in np.flatnonzero(passes)]

    def hold(self, reason: str) -> None:
        """Hold the position; see `Specimen.hold`."""
        self._held = self._held or reason

    def close(self) -> None:
        """End the session; see `Specimen.close`."""
        self.hold("the session was closed")

    def released(self) -> SimulatedSpecimen:
        """Unload the specimen to its initial force and set its zero there; see `Specimen.released`."""
        if self._description.stiffness is None:
            raise InputError("SimulatedSpecimen.stiffness", "missing", "the initial stiffness", "Unloading needs it.")
        after = copy(self)
        after._unload(np.array(self._description.stiffness))
        after._datum, after._held, after._command = after._place, "", 0.0 * after._place
        after._seed = self._seed + 1
        actuators = tuple(
            a if a.stroke is None else replace(a, stroke=a.stroke - abs(float(displacement)))
            for a, displacement in zip(self._transfer.actuators, after._datum - self._datum, strict=True)
        )
        after._transfer = TransferSystem(actuators, self._description.controller_step, after._seed)
        channels = tuple(
            channel.model_copy(update={"stroke": a.stroke})
            for channel, a in zip(self._description.channels, actuators, strict=True)
        )
        after._description = self._description.model_copy(
            update={"datum": tuple(map(float, after._datum)), "channels": channels}
        )
        return after

    def _unload(self, stiffness: np.ndarray) -> None:
        """Move the specimen until its force is the initial one. With the largest stiffness, moves do not overshoot."""
        back = np.linalg.inv(stiffness)
        for _ in range(MOST_RELEASES):
            excess = self._force - self._static
            if np.abs(excess).max() <= RELEASED * self._largest:
                return
            move = -back @ excess
            pieces = int(np.ceil(np.abs(move).max() / self.structure.largest_move)) or 1
            start = self._place
            for piece in range(1, pieces + 1):
                self._impose(start + piece / pieces * move)
        raise SpecimenError(f"The specimen could not be unloaded: a force of {np.abs(excess).max():.3g} N remains.")

    @property
    def held(self) -> str:
        """Reason why the specimen holds its position; empty while it can move."""
        return self._held

    @property
    def position(self) -> np.ndarray:
        """Position of the pistons, relative to the zero, shape (channel,) [m]."""
        return self._place - self._datum
