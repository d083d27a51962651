"""Giuffrè–Menegotto–Pinto law of steel, with isotropic hardening after Filippou, Popov & Bertero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.engine.array_module import namespace
from structid.mechanics.hysteresis import power
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, parameter
from structid.mechanics.hysteretic_laws.default_priors import HARDENING, STRENGTH, around, between, near_zero

SHIFT_EXPONENT = 0.8
"""Exponent of the shift of the yield line with the plastic excursion (Filippou, Popov & Bertero 1983)."""


@dataclass(frozen=True, eq=False)
class GiuffreMenegottoPinto(HystereticLaw):
    """Smooth curve between two asymptotes, from each reversal (d_r, f_r) to the point (d_0, f_0) where the asymptotes meet.

    ::

        f* = b d* + (1 − b) d* / (1 + |d*|^R)^(1/R),    d* = (d − d_r)/(d_0 − d_r),   f* = (f − f_r)/(f_0 − f_r)
        R = R_0 (1 − c_1 ξ/(c_2 + ξ)),                  ξ = |d_p − d_0|/u_y,  d_p the largest deformation in this direction
        shift of the yield line: 1 + a [(d_max − d_min)/(2 u_y)]^0.8

    As in OpenSees' Steel02, only the last reversal is remembered, so a small inner cycle does not close.
    """

    word: ClassVar[str] = "giuffre_menegotto_pinto"
    title: ClassVar[str] = "Giuffrè–Menegotto–Pinto law of steel"
    use: ClassVar[str] = "reinforcing bars and steel members without loss of strength"
    source: ClassVar[str] = "Menegotto & Pinto (1973); Filippou, Popov & Bertero (1983)"
    dissipative: ClassVar[bool] = False
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "hardening": 0.03,
        "isotropic_hardening": 0.02,
    }
    opensees: ClassVar[str] = (
        "Steel02 tag, yield_force, stiffness, hardening, transition, transition_loss, transition_scale, a, 1, a, 1, "
        "where a is isotropic_hardening"
    )

    yield_force: Any = parameter("yield force F_y", STRENGTH, "N")
    hardening: Any = parameter(
        "stiffness after yielding, relative to the initial stiffness, b",
        HARDENING,
        high=0.99,
        default=0.0,
        neutral=0.0,
        mechanism="hardening",
    )
    transition: Any = parameter("sharpness R_0 of the first bend", around(10.0, 2.0), low=1.0, default=20.0)
    transition_loss: Any = parameter(
        "loss of sharpness with plastic deformation, c_1", between(0.5, 0.95), high=0.99, default=0.925
    )
    transition_scale: Any = parameter("scale of that loss, c_2", around(0.15, 2.0), default=0.15)
    isotropic_hardening: Any = parameter(
        "shift of the yield lines with the plastic excursion, a",
        near_zero(0.1),
        low=-1.0,
        default=0.0,
        neutral=0.0,
        mechanism="isotropic hardening or softening",
    )

    def at_rest(self, zero: Any) -> Memory:
        """Return the variables of the first curve; see `HystereticLaw.at_rest`."""
        u_y = self.yield_force / self.stiffness + 0.0 * zero
        names = ("d", "f", "direction", "d_r", "f_r", "d_0", "f_0", "d_p")
        return dict.fromkeys(names, zero) | {"largest": u_y, "smallest": -u_y}

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`."""
        xp = namespace(deformation)
        sign = xp.sign(deformation - memory["d"])
        turned = sign * memory["direction"] < 0.0
        begun = (memory["direction"] == 0.0) & (sign != 0.0)
        after = {
            "d": deformation,
            "direction": xp.where(sign == 0.0, memory["direction"], sign),
            "largest": xp.where(turned & (sign < 0.0), xp.maximum(memory["largest"], memory["d"]), memory["largest"]),
            "smallest": xp.where(
                turned & (sign > 0.0), xp.minimum(memory["smallest"], memory["d"]), memory["smallest"]
            ),
        }
        u_y = self.yield_force / self.stiffness
        excursion = power((after["largest"] - after["smallest"]) / (2.0 * u_y), SHIFT_EXPONENT)
        shift = 1.0 + self.isotropic_hardening * excursion
        # The yield line ± F_y s + b k (d ∓ u_y s) meets the elastic line through the reversal.
        height = sign * shift * (1.0 - self.hardening) * self.yield_force
        d_0 = (height - memory["f"] + self.stiffness * memory["d"]) / (self.stiffness * (1.0 - self.hardening))
        f_0 = height + self.hardening * self.stiffness * d_0
        reached = xp.where(sign > 0.0, after["largest"], after["smallest"])
        for name, at_turn, at_start in (
            ("d_r", memory["d"], 0.0),
            ("f_r", memory["f"], 0.0),
            ("d_0", d_0, sign * u_y),
            ("f_0", f_0, sign * self.yield_force),
            ("d_p", reached, sign * u_y),
        ):
            after[name] = xp.where(turned, at_turn, xp.where(begun, at_start, memory[name]))
        after["f"] = xp.where(after["direction"] == 0.0, 0.0, self._curve(after, u_y))
        return after

    def _curve(self, curve: Memory, u_y: Any) -> Any:
        """Return the force on a curve."""
        xp = namespace(curve["d"])
        xi = xp.abs(curve["d_p"] - curve["d_0"]) / u_y
        r = self.transition * (1.0 - self.transition_loss * xi / (self.transition_scale + xi))
        length = curve["d_0"] - curve["d_r"]
        ratio = (curve["d"] - curve["d_r"]) / xp.where(length == 0.0, 1.0, length)
        bend = power(1.0 + power(xp.abs(ratio), r), 1.0 / r)
        star = self.hardening * ratio + (1.0 - self.hardening) * ratio / bend
        return curve["f_r"] + star * (curve["f_0"] - curve["f_r"])
