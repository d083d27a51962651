"""Masing spring: Jenkins elements in parallel, with damage by peak deformation and dissipated energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from structid.engine.array_module import namespace
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, clip, parameter
from structid.mechanics.hysteretic_laws.default_priors import (
    ASYMMETRY,
    ENERGY_DAMAGE,
    PEAK_DAMAGE,
    SHARPNESS,
    STIFFNESS_OF_BACKBONE,
    STRENGTH_OF_BACKBONE,
)

ELEMENTS = 20
"""Number of Jenkins elements; with 40 the force changes by less than 0.5 % of the strength."""


class JenkinsElements(NamedTuple):
    """Elastic–plastic elements of equal stiffness whose sum is the backbone x/(1 + (x/y)^N)^(1/N), in yield displacements.

    The backbone's slope is (1 + x^N)^(−1/N−1). The element that stands for the slopes about q yields where the slope is q:
    x(q) = (q^(−N/(N+1)) − 1)^(1/N). The backbone is the integral of min(x, x(q)) over q from 0 to 1; its midpoint rule are
    the elements (Iwan 1966).
    """

    limits: Any  # deformations at which the elements yield, (element, run)

    @classmethod
    def of_backbone(cls, sharpness: Any, like: Any) -> JenkinsElements:
        """Return the elements of a Richard–Abbott backbone with the exponent N."""
        xp = namespace(like)
        log_slopes = np.log((np.arange(ELEMENTS) + 0.5) / ELEMENTS).reshape((-1,) + (1,) * np.ndim(like))
        n = sharpness + 0.0 * like
        # q^(−N/(N+1)) − 1, then its power 1/N
        beyond = xp.exp(-n / (n + 1.0) * log_slopes) - 1.0
        return cls(xp.exp(xp.log(beyond) / n))

    def moved(self, forces: Any, change: Any, strengths: tuple[Any, Any]) -> tuple[Any, Any, Any]:
        """Deform the elements; return their forces, the mean force and the mean dissipated energy.

        `strengths` are the negative and the positive strength of the elements, relative to their undamaged strength.
        """
        xp = namespace(change)
        trial = forces + change
        after = clip(trial, -strengths[0] * self.limits, strengths[1] * self.limits)
        dissipated = xp.abs(trial - after) * xp.abs(after)
        return after, after.sum(axis=0) / ELEMENTS, dissipated.sum(axis=0) / ELEMENTS


class Damage(NamedTuple):
    """Loss of strength of Jenkins elements by peak deformation and dissipated energy."""

    per_ductility: Any  # δ_u
    per_energy: Any  # δ_E
    asymmetry: Any  # ρ

    def strengths(self, smallest: Any, largest: Any, energy: Any) -> tuple[Any, Any]:
        """Return the negative and the positive strength ρ± e^(−δ_u p±) / (1 + δ_E E), from the ductilities and the energy."""
        xp = namespace(largest)
        rest = 1.0 / (1.0 + self.per_energy * energy)
        negative = self.asymmetry * rest * xp.exp(self.per_ductility * smallest)
        return negative, rest * xp.exp(-self.per_ductility * largest)

    @staticmethod
    def rate(dissipated: Any, change: Any) -> Any:
        """Return the energy dissipated per deformation, with the sign of the move."""
        xp = namespace(change)
        return dissipated / xp.where(change == 0.0, 1.0, change)

    @staticmethod
    def predicted(rate: Any, change: Any) -> Any:
        """Return the energy of a move, if it goes on in the direction of the move before; else zero."""
        return namespace(change).maximum(rate * change, 0.0)


@dataclass(frozen=True, eq=False)
class Masing(HystereticLaw):
    """Masing spring with damage: a distribution of elastic–plastic elements, weakened by peaks and energy.

    With x = d/u_y, u_y = F_y/k, the force is F_y times the mean of Jenkins elements whose backbone is x/(1 + x^N)^(1/N). On
    each side their strength falls to ::

        ρ± e^(−δ_u p±) / (1 + δ_E E),      p± peak of x on this side, E dissipated energy per F_y u_y

    A move uses the energy at its end, predicted from the move before.
    """

    word: ClassVar[str] = "masing"
    title: ClassVar[str] = "Masing spring with damage (Iwan)"
    use: ClassVar[str] = "fat loops of steel, timber and soil, with loss of strength"
    accurate_move: ClassVar[float] = 0.1
    source: ClassVar[str] = "Iwan (1966)"
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 2.0,
        "sharpness": 1.0,
        "peak_damage": 0.05,
        "energy_damage": 0.03,
    }

    stiffness: Any = parameter("initial stiffness k", STIFFNESS_OF_BACKBONE, "N/m")
    yield_force: Any = parameter("strength F_y of the undamaged backbone", STRENGTH_OF_BACKBONE, "N")
    sharpness: Any = parameter("sharpness N of the backbone's bend", SHARPNESS, low=0.2, high=30.0)
    peak_damage: Any = parameter(
        "loss of strength per peak ductility, δ_u",
        PEAK_DAMAGE,
        default=0.0,
        neutral=0.0,
        mechanism="loss of strength with the peaks",
    )
    energy_damage: Any = parameter(
        "loss of strength per dissipated energy F_y u_y, δ_E",
        ENERGY_DAMAGE,
        default=0.0,
        neutral=0.0,
        mechanism="loss of strength with the dissipated energy",
    )
    asymmetry: Any = parameter(
        "negative strength, relative to the positive one, ρ",
        ASYMMETRY,
        default=1.0,
        neutral=1.0,
        mechanism="asymmetric strength",
    )

    def prepare(self, zero: Any) -> JenkinsElements:
        """Return the elements; see `HystereticLaw.prepare`."""
        return JenkinsElements.of_backbone(self.sharpness, zero)

    def at_rest(self, zero: Any) -> Memory:
        """Return the springs' variables at rest; see `HystereticLaw.at_rest`."""
        xp = namespace(zero)
        elements = xp.zeros((ELEMENTS, *np.shape(zero))) + 0.0 * zero
        return dict.fromkeys(("d", "f", "energy", "rate", "largest", "smallest"), zero) | {"elements": elements}

    def moved(self, prepared: JenkinsElements, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`."""
        xp = namespace(deformation)
        per_yield = self.stiffness / self.yield_force
        largest = xp.maximum(memory["largest"], deformation)
        smallest = xp.minimum(memory["smallest"], deformation)
        damage = Damage(self.peak_damage, self.energy_damage, self.asymmetry)
        change = per_yield * (deformation - memory["d"])
        energy = memory["energy"] + damage.predicted(memory["rate"], change)
        strengths = damage.strengths(per_yield * smallest, per_yield * largest, energy)
        elements, force, dissipated = prepared.moved(memory["elements"], change, strengths)
        return {
            "d": deformation,
            "f": self.yield_force * force,
            "elements": elements,
            "energy": memory["energy"] + dissipated,
            "rate": damage.rate(dissipated, change),
            "largest": largest,
            "smallest": smallest,
        }
