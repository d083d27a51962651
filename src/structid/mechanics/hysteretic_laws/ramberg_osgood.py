"""Ramberg–Osgood spring with Masing's rules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from structid.engine.array_module import namespace
from structid.mechanics.hysteresis import power
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, parameter
from structid.mechanics.hysteretic_laws.default_priors import STRENGTH, around

NEWTON_ITERATIONS = 14
"""Iterations for the force; each at least halves the error of a convex equation until it is small, then squares it."""
REVERSALS = 8
"""Number of remembered reversals. A path with more cycles inside one another forgets the smallest of them."""


@dataclass(frozen=True, eq=False)
class RambergOsgood(HystereticLaw):
    """Curve d = f/k + η u_y (|f|/F_y)^n sign f, with u_y = F_y/k.

    Masing's rules: after a reversal (d_r, f_r) the curve is doubled, (d − d_r)/2 = … of (f − f_r)/2. A curve that passes the
    reversal before the last continues the curve interrupted there, and beyond the largest deformation the first curve.
    """

    word: ClassVar[str] = "ramberg_osgood"
    title: ClassVar[str] = "Ramberg–Osgood spring"
    use: ClassVar[str] = "steel and soil with gradual yielding"
    source: ClassVar[str] = "Ramberg & Osgood (1943); Jennings (1964)"
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "offset": 0.5,
        "sharpness": 5.0,
    }

    yield_force: Any = parameter("reference force F_y", STRENGTH, "N")
    offset: Any = parameter(
        "plastic deformation at the reference force, relative to u_y, η", around(0.5, 4.0), default=1.0
    )
    sharpness: Any = parameter("exponent n", around(5.0, 2.5, low=1.0), low=1.0)

    def at_rest(self, zero: Any) -> Memory:
        """Return deformation, force and reversals; see `HystereticLaw.at_rest`."""
        names = [f"{name}_{j}" for j in range(REVERSALS) for name in ("d", "f")]
        return dict.fromkeys(("d", "f", "direction", "largest", "count", *names), zero)

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`."""
        xp = namespace(deformation)
        sign = xp.sign(deformation - memory["d"])
        after = self._turned(memory, sign)
        after["direction"] = xp.where(sign == 0.0, memory["direction"], sign)
        after = self._closed(after, sign, deformation)
        after["d"] = deformation
        after["largest"] = xp.maximum(memory["largest"], xp.abs(deformation))
        first = after["count"] == 0.0
        doubled = xp.where(first, 1.0, 2.0)
        origin_d, origin_f = (xp.where(first, 0.0, after[f"{name}_0"]) for name in ("d", "f"))
        after["f"] = origin_f + doubled * self._force((deformation - origin_d) / doubled)
        return after

    def _turned(self, memory: Memory, sign: Any) -> Memory:
        """Return the memory with a new reversal in front, where the direction has changed."""
        xp = namespace(sign)
        turned = sign * memory["direction"] < 0.0
        full = memory["count"] >= REVERSALS
        after = dict(memory)
        for name in ("d", "f"):
            before = [memory[f"{name}_{j}"] for j in range(REVERSALS)]
            moved_in = [memory[name], *before[:-1]]
            # If all places are taken, the innermost cycle, of the two last reversals, is forgotten.
            without = [memory[name], *before[2:], before[-1]]
            for j in range(REVERSALS):
                after[f"{name}_{j}"] = xp.where(turned, xp.where(full, without[j], moved_in[j]), before[j])
        count = xp.where(full, REVERSALS - 1.0, memory["count"] + 1.0)
        after["count"] = xp.where(turned, count, memory["count"])
        return after

    def _closed(self, memory: Memory, sign: Any, deformation: Any) -> Memory:
        """Return the memory without the inner cycles that a move closes: those whose earlier reversal it passes."""
        xp = namespace(sign)
        after = dict(memory)
        for _ in range(REVERSALS // 2):
            passes = (sign != 0.0) & (after["count"] >= 2.0) & (sign * (deformation - after["d_1"]) >= 0.0)
            for name in ("d", "f"):
                for j in range(REVERSALS):
                    two_on = after[f"{name}_{j + 2}"] if j + 2 < REVERSALS else after[f"{name}_{j}"]
                    after[f"{name}_{j}"] = xp.where(passes, two_on, after[f"{name}_{j}"])
            after["count"] = xp.where(passes, after["count"] - 2.0, after["count"])
        beyond = xp.abs(deformation) >= after["largest"]
        after["count"] = xp.where(beyond & (sign != 0.0), 0.0, after["count"])
        return after

    def _force(self, deformation: Any) -> Any:
        """Solve x + η x^n = |d|/u_y for the force x F_y."""
        xp = namespace(deformation)
        asked = xp.abs(deformation) * self.stiffness / self.yield_force
        # Both terms alone are upper bounds of the root; Newton's method on a convex equation falls from there to it.
        x = xp.minimum(asked, power(asked / self.offset, 1.0 / self.sharpness))
        for _ in range(NEWTON_ITERATIONS):
            bent = self.offset * power(x, self.sharpness)
            slope = 1.0 + self.sharpness * bent / xp.where(x > 0.0, x, 1.0)
            x = x - (x + bent - asked) / slope
        return xp.sign(deformation) * x * self.yield_force
