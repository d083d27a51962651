"""A simulated transfer system: delayed actuators with limits, and noisy sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from structid.core.errors import InputError
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments

CONTROLLER_STEP = 1e-3
"""T_c [s] of wall time."""


@check_arguments
@dataclass(frozen=True)
class Sensor:
    """A sensor with white noise and an analogue-to-digital converter.

    Parameters
    ----------
    noise : float
        Standard deviation of the noise [m] or [N].
    range : float, optional
        Measuring range of the converter [m] or [N]; default: an ideal converter.
    bits : int
        Number of bits of the converter; its resolution is range/2^bits.

    Examples
    --------
    >>> import structid as si
    >>> cell = si.Sensor(noise=50.0, range=2e5, bits=16)
    >>> cell.bits
    16
    """

    noise: float = 0.0
    range: float | None = None
    bits: int = 16

    def __post_init__(self) -> None:
        if not self.noise >= 0.0 or (self.range is not None and not self.range > 0.0) or self.bits < 1:
            raise InputError("Sensor", f"{self}", "a noise of 0 or more, a positive range, one bit or more")

    @property
    def quantum(self) -> float:
        """Resolution of the converter [m] or [N]; 0 for an ideal converter."""
        return 0.0 if self.range is None else self.range / 2**self.bits

    def seen(self, values: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Readings of true values.

        Parameters
        ----------
        values : ndarray
            True values [m] or [N].
        random : numpy.random.Generator
            Generator of the noise.

        Returns
        -------
        ndarray
            Readings, in the same shape.
        """
        noisy = values + self.noise * random.normal(size=values.shape) if self.noise else values
        return self.quantum * np.round(noisy / self.quantum) if self.quantum else noisy


@check_arguments
@dataclass(frozen=True)
class Actuator:
    """An actuator with a stroke limit, a pure delay τ, a first-order lag T_a and a velocity limit.

        u_m′ = (c(t − τ) − u_m)/T_a

    A command c_k is the target at the end of controller step k, and is constant during this step. The lag is integrated exactly
    for such commands. At the ends of the steps, it acts as a delay of T_a − T_c/2.

    Parameters
    ----------
    delay, lag : float
        τ and T_a [s] of wall time.
    stroke, velocity, force : float, optional
        Largest absolute displacement [m], velocity [m/s] of wall time, and force [N]; default: no limit. The actuator cannot
        move farther or faster. A force beyond its limit stops the test.
    displacement_sensor, force_sensor : Sensor
        Sensors of the piston and of the load cell.

    Examples
    --------
    >>> import structid as si
    >>> actuator = si.Actuator(delay=0.012, stroke=0.1, velocity=0.2, force=2e5)
    >>> actuator.delay
    0.012
    """

    delay: float = 0.0
    lag: float = 0.0
    stroke: float | None = None
    velocity: float | None = None
    force: float | None = None
    displacement_sensor: Sensor = field(default_factory=Sensor)
    force_sensor: Sensor = field(default_factory=Sensor)

    def __post_init__(self) -> None:
        for name in ("delay", "lag"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise InputError(f"Actuator.{name}", f"{getattr(self, name)!r}", "seconds of wall time, 0 or more")
        for name in ("stroke", "velocity", "force"):
            limit = getattr(self, name)
            if limit is not None and not limit > 0.0:
                raise InputError(f"Actuator.{name}", f"{limit!r}", "a positive limit, or None")


class TransferSystem:
    """Actuators and sensors of all channels; a path has one value per controller step."""

    def __init__(
        self, actuators: tuple[Actuator, ...], controller_step: float = CONTROLLER_STEP, seed: int = 0
    ) -> None:
        if not controller_step > 0.0:
            raise InputError("controller_step", f"{controller_step!r}", "a positive time in seconds")
        self.actuators, self.controller_step = actuators, controller_step
        self._random = stream(seed, Purpose.SENSOR_NOISE)
        self._pistons = [_Piston(actuator, controller_step) for actuator in actuators]

    def followed(self, path: Float[np.ndarray, "sample channel"]) -> Float[np.ndarray, "sample channel"]:
        """Return the positions of the actuators along a path."""
        return np.stack([p.followed(path[:, k]) for k, p in enumerate(self._pistons)], axis=1)

    def seen(
        self, displacement: Float[np.ndarray, "sample channel"], force: Float[np.ndarray, "sample channel"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Readings of the sensors."""
        return (
            np.stack(
                [
                    a.displacement_sensor.seen(x, self._random)
                    for a, x in zip(self.actuators, displacement.T, strict=True)
                ],
                1,
            ),
            np.stack([a.force_sensor.seen(x, self._random) for a, x in zip(self.actuators, force.T, strict=True)], 1),
        )


class _Piston:
    """Position and past commands of one actuator."""

    def __init__(self, actuator: Actuator, step: float) -> None:
        self.actuator, self.place = actuator, 0.0
        whole = actuator.delay / step
        # With a delay of q + f steps, the command from q + 1 steps earlier still acts during the first fraction f of a step.
        self.before = int(np.floor(whole + 1e-9))
        self.part = max(whole - self.before, 0.0)
        self.sent = np.zeros(self.before + 1)
        """Last commands, oldest first."""
        lag = actuator.lag
        self.kept = (
            (float(np.exp(-self.part * step / lag)), float(np.exp(-(1.0 - self.part) * step / lag)))
            if lag
            else (0.0, 0.0)
        )
        self.farthest = np.inf if actuator.velocity is None else actuator.velocity * step

    def followed(self, commands: np.ndarray) -> np.ndarray:
        """Positions at the ends of controller steps, shape (sample,)."""
        stroke = np.inf if self.actuator.stroke is None else self.actuator.stroke
        sent = np.concatenate([self.sent, np.clip(commands, -stroke, stroke)])
        self.sent = sent[len(commands) :]
        old, new = sent[: len(commands)], sent[1 : len(commands) + 1]
        # x₁ = k₂ k₁ x₀ + k₂ (1 − k₁) c_old + (1 − k₂) c_new
        first, second = self.kept
        pulled = second * (1.0 - first) * old + (1.0 - second) * new
        if np.isinf(self.farthest):
            kept = first * second
            places, _ = lfilter([1.0], [1.0, -kept], pulled, zi=[kept * self.place])
        else:
            places = np.empty(len(commands))
            position = self.place
            for k, pull in enumerate(pulled):
                move = first * second * position + pull - position
                position += min(max(move, -self.farthest), self.farthest)
                places[k] = position
        self.place = float(places[-1])
        return np.asarray(places)
