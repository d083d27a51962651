"""Bilinear spring with kinematic hardening."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, clip, parameter
from structid.mechanics.hysteretic_laws.default_priors import ASYMMETRY, HARDENING, STRENGTH


@dataclass(frozen=True, eq=False)
class Bilinear(HystereticLaw):
    """Force of an elastic spring beside an elastic–plastic one.

    f = b k d + (1 − b) f_p,   f_p ← min(max(f_p + k Δd, −ρ F_y), F_y)
    """

    word: ClassVar[str] = "bilinear"
    title: ClassVar[str] = "bilinear spring with kinematic hardening"
    use: ClassVar[str] = "steel storeys, yielding dampers, isolators"
    source: ClassVar[str] = ""
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "hardening": 0.05,
        "asymmetry": 0.8,
    }
    opensees: ClassVar[str] = "Steel01 tag, yield_force, stiffness, hardening"

    yield_force: Any = parameter("yield force F_y", STRENGTH, "N")
    hardening: Any = parameter(
        "stiffness after yielding, relative to the initial stiffness, b",
        HARDENING,
        high=1.0,
        default=0.0,
        neutral=0.0,
        mechanism="hardening",
    )
    asymmetry: Any = parameter(
        "negative yield force, relative to the positive one, ρ",
        ASYMMETRY,
        default=1.0,
        neutral=1.0,
        mechanism="asymmetric strength",
    )

    def at_rest(self, zero: Any) -> Memory:
        """Return deformation, force and the force of the elastic–plastic part; see `HystereticLaw.at_rest`."""
        return {"d": zero, "f": zero, "plastic": zero}

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`."""
        trial = memory["plastic"] + self.stiffness * (deformation - memory["d"])
        plastic = clip(trial, -self.asymmetry * self.yield_force, self.yield_force)
        force = self.hardening * self.stiffness * deformation + (1.0 - self.hardening) * plastic
        return {"d": deformation, "f": force, "plastic": plastic}
