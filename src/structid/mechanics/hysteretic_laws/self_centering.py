"""Flag-shaped, self-centring spring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.engine.array_module import namespace
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, clip, parameter
from structid.mechanics.hysteretic_laws.default_priors import ASYMMETRY, HARDENING, STRENGTH, between


@dataclass(frozen=True, eq=False)
class SelfCentering(HystereticLaw):
    """Flag-shaped spring that returns to its origin.

    For d > 0 the force follows k Δd between two lines, and mirrored with the strength ρ F_y for d < 0::

        min(k d, F_y + b k (d − u_y)),      min(k d, (1 − β) F_y + b k (d − (1 − β) u_y)),       u_y = F_y/k
    """

    word: ClassVar[str] = "self_centering"
    title: ClassVar[str] = "flag-shaped, self-centring spring"
    use: ClassVar[str] = "rocking and post-tensioned walls, self-centring braces"
    source: ClassVar[str] = "Christopoulos, Filiatrault & Folz (2002)"
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "hardening": 0.05,
        "flag_height": 0.7,
        "asymmetry": 0.9,
    }
    opensees: ClassVar[str] = "SelfCentering tag, stiffness, hardening · stiffness, yield_force, flag_height"

    yield_force: Any = parameter("activation force F_y", STRENGTH, "N")
    hardening: Any = parameter(
        "stiffness after activation, relative to the initial stiffness, b",
        HARDENING,
        high=1.0,
        default=0.0,
        neutral=0.0,
        mechanism="hardening",
    )
    flag_height: Any = parameter("height of the flag, relative to the activation force, β", between(0.0, 1.0), high=1.0)
    asymmetry: Any = parameter(
        "negative activation force, relative to the positive one, ρ",
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
        xp = namespace(deformation)
        sign = xp.where(deformation < 0.0, -1.0, 1.0)
        side = self.yield_force * xp.where(deformation < 0.0, self.asymmetry, 1.0)
        trial = sign * (memory["f"] + self.stiffness * (deformation - memory["d"]))
        size = xp.abs(deformation)
        return {
            "d": deformation,
            "f": sign * clip(trial, self._line((1.0 - self.flag_height) * side, size), self._line(side, size)),
        }

    def _line(self, force: Any, size: Any) -> Any:
        """Return the bilinear line that bends at a force."""
        xp = namespace(size)
        elastic = self.stiffness * size
        return xp.minimum(elastic, force + self.hardening * (elastic - force))
