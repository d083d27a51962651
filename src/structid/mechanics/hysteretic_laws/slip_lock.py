"""Smooth hysteretic law with a slip–lock element in series."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from structid.engine.array_module import namespace
from structid.mechanics.hysteresis import LONGEST_STEP, power
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, parameter
from structid.mechanics.hysteretic_laws.default_priors import ASYMMETRY, HARDENING, around, between, up_to
from structid.mechanics.runge_kutta import runge_kutta_4

SMALLEST_WIDTH = 0.02
"""Smallest width of the slip, relative to the strength; a narrower slip would be a jump."""


@dataclass(frozen=True, eq=False)
class SlipLock(HystereticLaw):
    """Smooth hysteretic spring in series with a slip–lock element, beside an elastic spring.

    ::

        f = k [a d + (1 − a) z],    z′ = G d′/(1 + K G)
        G = R_K {1 − |z/z_y|ⁿ [(1 − g)/2 sgn(z d′) + (1 + g)/2]}
        R_K = (|z| + a_p z_y0)/(|d| + a_p z_y0), at most 1, for z d > 0      stiffness towards a pivot
        z_y = ρ± z_y0/(1 + δ_E E),   z_y0 = F_y/k                            strength
        K = s/(√(2π) σ z_y) exp(−½ ((z sgn d′ − q z_y)/(σ z_y))²)            slip of the length s in every half-cycle
        s = R_s (d_max − d_min) + s_E E

    E is the absorbed energy per F_y u_y. Without slip, pivot and damage it is the Bouc–Wen law with γ/β = g-dependent unloading.
    """

    word: ClassVar[str] = "slip_lock"
    title: ClassVar[str] = "smooth hysteretic law with slip–lock"
    use: ClassVar[str] = "timber connections and joints with slip, pinched reinforced concrete"
    source: ClassVar[str] = "Sivaselvan & Reinhorn (2000); Baber & Noori (1985); Foliente (1995)"
    accurate_move: ClassVar[float] = 0.02
    dissipative: ClassVar[bool] = False
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "hardening": 0.05,
        "slip": 0.3,
        "pivot": 5.0,
        "energy_damage": 0.02,
        "slip_force": 0.2,
        "asymmetry": 0.9,
    }

    yield_force: Any = parameter("yield force F_y of the undamaged law", around(0.8, 2.5), "N")
    hardening: Any = parameter(
        "final stiffness, relative to the initial stiffness, a",
        HARDENING,
        high=1.0,
        default=0.0,
        neutral=0.0,
        mechanism="hardening",
    )
    exponent: Any = parameter(
        "sharpness n of the yielding", around(1.0, 3.0, low=0.2, high=20.0), low=0.2, high=20.0, default=2.0
    )
    unloading: Any = parameter(
        "shape of unloading, g; 0 is straight", between(-0.9, 0.9), low=-1.0, high=1.0, default=0.0
    )
    pivot: Any = parameter(
        "distance of the pivot, relative to z_y0, a_p",
        around(5.0, 10.0),
        default=1e9,
        neutral=1e9,
        mechanism="loss of stiffness with the displacement",
    )
    energy_damage: Any = parameter(
        "loss of strength per absorbed energy F_y u_y, δ_E",
        up_to(0.3),
        default=0.0,
        neutral=0.0,
        mechanism="loss of strength with the energy",
    )
    asymmetry: Any = parameter(
        "negative strength, relative to the positive one, ρ",
        ASYMMETRY,
        default=1.0,
        neutral=1.0,
        mechanism="asymmetric strength",
    )
    slip: Any = parameter(
        "length of the slip, relative to the range of the deformations, R_s",
        up_to(0.5),
        high=0.95,
        default=0.0,
        neutral=0.0,
        mechanism="slip",
    )
    slip_growth: Any = parameter(
        "growth of the slip per absorbed energy F_y u_y, relative to u_y, s_E",
        up_to(0.05),
        default=0.0,
        neutral=0.0,
        mechanism="slip that grows with the energy",
    )
    slip_width: Any = parameter(
        "width of the slip, relative to the strength, σ", around(0.2, 3.0, low=0.02), low=SMALLEST_WIDTH, default=0.2
    )
    slip_force: Any = parameter(
        "force at the middle of the slip, relative to the strength, q",
        between(0.0, 0.6),
        low=0.0,
        high=1.0,
        default=0.0,
    )

    def at_rest(self, zero: Any) -> Memory:
        """Return the spring's variables at rest; see `HystereticLaw.at_rest`."""
        return dict.fromkeys(("d", "f", "z", "energy", "largest", "smallest"), zero)

    def moved(self, prepared: Any, memory: Memory, deformation: Any) -> Memory:
        """Move the spring by one Runge–Kutta step; see `HystereticLaw.moved`."""
        xp = namespace(deformation)
        change = deformation - memory["d"]
        sign, slip = xp.sign(change), self.slip * (memory["largest"] - memory["smallest"])
        per_energy = (1.0 - self.hardening) * self.stiffness**2 / self.yield_force**2

        def rate(state: Memory, velocity: Any) -> Memory:
            z, energy = state["z"], state["energy"]
            return {
                "d": velocity,
                "z": self._stiffness(state["d"], z, energy, sign, slip) * velocity,
                "energy": per_energy * z * velocity,
            }

        start = {name: memory[name] for name in ("d", "z", "energy")}
        after: Memory = runge_kutta_4(rate, start, (change, change, change), 1.0)
        after["d"] = deformation
        after["f"] = self.stiffness * (self.hardening * deformation + (1.0 - self.hardening) * after["z"])
        after["largest"] = xp.maximum(memory["largest"], deformation)
        after["smallest"] = xp.minimum(memory["smallest"], deformation)
        return after

    def _stiffness(self, deformation: Any, z: Any, energy: Any, sign: Any, slip: Any) -> Any:
        """Return dz/dd, in the direction of the move."""
        xp = namespace(deformation)
        u_y = self.yield_force / self.stiffness
        absorbed = xp.maximum(energy, 0.0)
        strength = u_y * xp.where(z < 0.0, self.asymmetry, 1.0) / (1.0 + self.energy_damage * absorbed)
        size = xp.abs(z)
        to_pivot = (size + self.pivot * u_y) / (xp.abs(deformation) + self.pivot * u_y)
        pivoted = xp.where(z * deformation > 0.0, xp.minimum(to_pivot, 1.0), 1.0)
        shape = 0.5 * (1.0 - self.unloading) * xp.sign(z) * sign + 0.5 * (1.0 + self.unloading)
        g = pivoted * (1.0 - power(size / strength, self.exponent) * shape)
        length = slip + self.slip_growth * u_y * absorbed
        width = self.slip_width * strength
        from_middle = (sign * z - self.slip_force * strength) / width
        slipping = length / (math.sqrt(2.0 * math.pi) * width) * xp.exp(-0.5 * from_middle**2)
        return g / (1.0 + slipping * xp.maximum(g, 0.0))

    def longest_move(self) -> Any:
        """Return the move over which z loses its memory, or enters the slip; see `HystereticLaw.longest_move`."""
        xp = namespace(self.yield_force)
        u_y = self.yield_force / self.stiffness * xp.minimum(self.asymmetry, 1.0)
        return LONGEST_STEP * u_y / xp.maximum(self.exponent, 1.0)
