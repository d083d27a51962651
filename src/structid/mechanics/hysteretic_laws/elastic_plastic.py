"""Elastic–perfectly plastic spring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, clip, parameter
from structid.mechanics.hysteretic_laws.default_priors import ASYMMETRY, STRENGTH


@dataclass(frozen=True, eq=False)
class ElasticPlastic(HystereticLaw):
    """Force f ← min(max(f + k Δd, −ρ F_y), F_y)."""

    word: ClassVar[str] = "elastic_plastic"
    title: ClassVar[str] = "elastic–perfectly plastic spring"
    use: ClassVar[str] = "friction and sliding"
    source: ClassVar[str] = ""
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "asymmetry": 0.8,
    }
    opensees: ClassVar[str] = "ElasticPP tag, stiffness, yield displacement"

    yield_force: Any = parameter("yield force F_y", STRENGTH, "N")
    asymmetry: Any = parameter(
        "negative yield force, relative to the positive one, ρ",
        ASYMMETRY,
        default=1.0,
        neutral=1.0,
        mechanism="asymmetric strength",
    )

    def at_rest(self, zero: Any) -> Memory:
        """Return deformation and force; see `HystereticLaw.at_rest`."""
        return {"d": zero, "f": zero}

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`."""
        trial = memory["f"] + self.stiffness * (deformation - memory["d"])
        return {"d": deformation, "f": clip(trial, -self.asymmetry * self.yield_force, self.yield_force)}
