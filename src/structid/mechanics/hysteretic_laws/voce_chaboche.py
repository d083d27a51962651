"""Voce–Chaboche law of steel: isotropic and kinematic hardening that saturate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.engine.array_module import namespace
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, parameter
from structid.mechanics.hysteretic_laws.default_priors import around, near_zero, up_to

NEWTON_ITERATIONS = 12
"""Iterations for the plastic deformation of a move. The equation is convex and decreasing, so they approach the root from one
side; twelve give the last digits for moves of a hundred yield displacements."""


@dataclass(frozen=True, eq=False)
class VoceChaboche(HystereticLaw):
    """Elastic spring with a yield force that grows and a centre that moves, both with the plastic deformation p.

    With the yield displacement u_y = F_y/k::

        yield force     F_y [1 + q (1 − e^(−b p/u_y))]                                           (Voce)
        centre          α′ = c k d_p′ − (γ/u_y) α p′,    first and second backstress              (Armstrong–Frederick)

    The equations of a monotonic move have a closed form in the change of p, which Newton's method finds.
    """

    word: ClassVar[str] = "voce_chaboche"
    title: ClassVar[str] = "Voce–Chaboche law of steel"
    use: ClassVar[str] = "steel members and yielding dampers that harden with the cycles"
    source: ClassVar[str] = "Voce (1948); Chaboche (1986); Hartloper, de Castro e Sousa & Lignos (2021)"
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 0.7,
        "isotropic_hardening": 0.3,
        "isotropic_rate": 0.05,
        "kinematic_stiffness": 0.1,
        "kinematic_rate": 0.2,
    }
    opensees: ClassVar[str] = "UVCuniaxial tag, stiffness, F_y, q F_y, b/u_y, 0, 1, 2, c k, γ/u_y, c₂ k, γ₂/u_y"

    yield_force: Any = parameter("first yield force F_y", around(0.6, 2.0), "N")
    isotropic_hardening: Any = parameter(
        "growth of the yield force, relative to the first one, q",
        near_zero(0.5),
        low=-0.9,
        default=0.0,
        neutral=0.0,
        mechanism="isotropic hardening or softening",
    )
    isotropic_rate: Any = parameter("rate of that growth per yield displacement, b", around(0.02, 10.0), default=0.0)
    kinematic_stiffness: Any = parameter(
        "stiffness of the first backstress, relative to the initial stiffness, c",
        around(0.1, 5.0),
        default=0.0,
        neutral=0.0,
        mechanism="kinematic hardening",
    )
    kinematic_rate: Any = parameter(
        "rate of the first backstress per yield displacement, γ", around(0.1, 10.0), default=0.0
    )
    second_stiffness: Any = parameter(
        "stiffness of the second backstress, relative to the initial stiffness, c₂",
        up_to(0.05),
        default=0.0,
        neutral=0.0,
    )
    second_rate: Any = parameter(
        "rate of the second backstress per yield displacement, γ₂", around(0.01, 10.0), default=0.0
    )

    def at_rest(self, zero: Any) -> Memory:
        """Return deformation, force, backstresses and plastic deformation; see `HystereticLaw.at_rest`."""
        return dict.fromkeys(("d", "f", "first", "second", "plastic"), zero)

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`."""
        xp = namespace(deformation)
        # In units of F_y and u_y the stiffness is 1.
        force, first, second = (memory[name] / self.yield_force for name in ("f", "first", "second"))
        trial = force + (deformation - memory["d"]) * self.stiffness / self.yield_force
        sign = xp.where(trial < first + second, -1.0, 1.0)
        plastic, change = memory["plastic"], 0.0 * trial
        for _ in range(NEWTON_ITERATIONS):
            excess, slope = self._excess(sign * trial, sign * first, sign * second, plastic, change)
            change = xp.maximum(change + excess / slope, 0.0)
        first, second = (
            sign * self._backstress(sign * value, c, rate, change)[0]
            for value, c, rate in (
                (first, self.kinematic_stiffness, self.kinematic_rate),
                (second, self.second_stiffness, self.second_rate),
            )
        )
        return {
            "d": deformation,
            "f": self.yield_force * (trial - sign * change),
            "first": self.yield_force * first,
            "second": self.yield_force * second,
            "plastic": plastic + change,
        }

    def _excess(self, trial: Any, first: Any, second: Any, plastic: Any, change: Any) -> tuple[Any, Any]:
        """Return the force beyond yielding after a plastic change, and minus its slope, in the direction of the move."""
        xp = namespace(trial)
        saturation = xp.exp(-self.isotropic_rate * (plastic + change))
        centre, centre_slope = self._backstress(first, self.kinematic_stiffness, self.kinematic_rate, change)
        centre_2, centre_slope_2 = self._backstress(second, self.second_stiffness, self.second_rate, change)
        limit = 1.0 + self.isotropic_hardening * (1.0 - saturation)
        slope = 1.0 + centre_slope + centre_slope_2 + self.isotropic_hardening * self.isotropic_rate * saturation
        return trial - change - centre - centre_2 - limit, slope

    @staticmethod
    def _backstress(before: Any, stiffness: Any, rate: Any, change: Any) -> tuple[Any, Any]:
        """Return the backstress after a plastic change, and its slope.

        α = c/γ + (α_0 − c/γ) e^(−γ p),  or α_0 + c p without γ
        """
        xp = namespace(change)
        saturates = rate > 0.0
        safe = xp.where(saturates, rate, 1.0)
        decay = xp.exp(-rate * change)
        # (1 − e^(−γ p))/γ, which tends to p
        grown = xp.where(saturates, (1.0 - decay) / safe, change)
        return before * decay + stiffness * grown, (stiffness - rate * before) * decay
