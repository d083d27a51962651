"""Masing spring and flag-shaped spring in parallel, with damage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from structid.engine.array_module import namespace
from structid.mechanics.hysteresis import power
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, clip, parameter
from structid.mechanics.hysteretic_laws.default_priors import (
    ASYMMETRY,
    ENERGY_DAMAGE,
    PEAK_DAMAGE,
    SHARPNESS,
    STIFFNESS_OF_BACKBONE,
    STRENGTH_OF_BACKBONE,
    around,
    between,
)
from structid.mechanics.hysteretic_laws.masing import ELEMENTS, Damage, JenkinsElements


class Prepared(NamedTuple):
    """Numbers of a spring that depend on its parameters only."""

    per_yield: Any  # 1/u_y [1/m]
    jenkins: JenkinsElements


@dataclass(frozen=True, eq=False)
class MasingFlag(HystereticLaw):
    """Masing spring and pinched, flag-shaped spring in parallel, both weakened by peaks and energy.

    With x = d/u_y, u_y = F_y/k, the backbone b(x) = x/(1 + x^N)^(1/N), and the peak p± of x on each side::

        f = F_y [(1 − w) F_M + w F_F]
        F_F follows 2 Δx inside [λR, R],      R = ρ± b(p±) e^(−(p±/x_s)²) (|x|/p±)^m / (1 + δ_F E_F)

    F_M is the mean of Jenkins elements of the strength ρ± e^(−δ_u p±) / (1 + δ_E E_M), see `Masing`. E_M is the energy that they
    have dissipated, and E_F the energy that the flag has absorbed, both per F_y u_y. A move uses the energies at its end,
    predicted from the move before.
    """

    word: ClassVar[str] = "masing_flag"
    title: ClassVar[str] = "Masing and flag-shaped springs in parallel, with damage"
    use: ClassVar[str] = "masonry, reinforced concrete, timber, rocking: pinched loops that weaken"
    accurate_move: ClassVar[float] = 0.1
    dissipative: ClassVar[bool] = False
    source: ClassVar[str] = "Iwan (1966); Richard & Abbott (1975)"
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 2.0,
        "sharpness": 1.0,
        "flag_share": 0.5,
        "flag_return": 0.3,
        "pinching": 1.5,
        "softening_displacement": 3.0,
        "energy_damage": 0.02,
        "flag_damage": 0.02,
        "asymmetry": 0.9,
    }

    stiffness: Any = parameter("initial stiffness k", STIFFNESS_OF_BACKBONE, "N/m")
    yield_force: Any = parameter("strength F_y of the undamaged backbone", STRENGTH_OF_BACKBONE, "N")
    sharpness: Any = parameter("sharpness N of the backbone's bend", SHARPNESS, low=0.2, high=30.0)
    flag_share: Any = parameter(
        "share w of the flag in the strength", between(0.0, 1.0), high=1.0, neutral=0.0, mechanism="pinching"
    )
    flag_return: Any = parameter(
        "unloading force of the flag, relative to its loading force, λ", between(0.0, 1.0), high=1.0
    )
    pinching: Any = parameter(
        "exponent m of reloading towards the peak", around(1.3, 3.0, low=0.2, high=10.0), low=0.2, high=10.0
    )
    softening_displacement: Any = parameter(
        "peak deformation at which the flag has 37 % of its strength, u_s",
        around(2.0, 5.0),
        "m",
        default=np.inf,
        neutral=np.inf,
        mechanism="loss of pinched strength with the peaks",
    )
    peak_damage: Any = parameter(
        "loss of strength of the Masing part per peak ductility, δ_u",
        PEAK_DAMAGE,
        default=0.0,
        neutral=0.0,
        mechanism="loss of strength with the peaks",
    )
    energy_damage: Any = parameter(
        "loss of strength of the Masing part per dissipated energy F_y u_y, δ_E",
        ENERGY_DAMAGE,
        default=0.0,
        neutral=0.0,
        mechanism="loss of strength with the dissipated energy",
    )
    flag_damage: Any = parameter(
        "loss of strength of the flag per absorbed energy F_y u_y, δ_F",
        ENERGY_DAMAGE,
        default=0.0,
        neutral=0.0,
        mechanism="loss of pinched strength with the energy",
    )
    asymmetry: Any = parameter(
        "negative strength, relative to the positive one, ρ",
        ASYMMETRY,
        default=1.0,
        neutral=1.0,
        mechanism="asymmetric strength",
    )

    def prepare(self, zero: Any) -> Prepared:
        """Return the elements; see `HystereticLaw.prepare`."""
        per_yield = self.stiffness / self.yield_force
        return Prepared(per_yield, JenkinsElements.of_backbone(self.sharpness, zero))

    def at_rest(self, zero: Any) -> Memory:
        """Return the springs' variables at rest; see `HystereticLaw.at_rest`."""
        xp = namespace(zero)
        names = ("d", "f", "flag", "energy", "rate", "absorbed", "largest", "smallest")
        return dict.fromkeys(names, zero) | {"elements": xp.zeros((ELEMENTS, *np.shape(zero))) + 0.0 * zero}

    def moved(self, prepared: Prepared, memory: Memory, deformation: Any) -> Memory:
        """Move the spring; see `HystereticLaw.moved`."""
        xp = namespace(deformation)
        change = (deformation - memory["d"]) * prepared.per_yield
        largest = xp.maximum(memory["largest"], deformation)
        smallest = xp.minimum(memory["smallest"], deformation)
        damage = Damage(self.peak_damage, self.energy_damage, self.asymmetry)
        energy = memory["energy"] + damage.predicted(memory["rate"], change)
        strengths = damage.strengths(prepared.per_yield * smallest, prepared.per_yield * largest, energy)
        elements, masing, dissipated = prepared.jenkins.moved(memory["elements"], change, strengths)
        flag = self._flag(prepared, memory, change, deformation, xp.where(deformation > 0.0, largest, -smallest))
        return {
            "d": deformation,
            "f": self.yield_force * ((1.0 - self.flag_share) * masing + self.flag_share * flag),
            "elements": elements,
            "flag": flag,
            "energy": memory["energy"] + dissipated,
            "rate": damage.rate(dissipated, change),
            "absorbed": memory["absorbed"] + 0.5 * (memory["flag"] + flag) * change,
            "largest": largest,
            "smallest": smallest,
        }

    def _flag(self, prepared: Prepared, memory: Memory, change: Any, deformation: Any, peak: Any) -> Any:
        """Return F_F after a move; `peak` is the peak deformation on the side of the deformation."""
        xp = namespace(deformation)
        x, p = prepared.per_yield * xp.abs(deformation), prepared.per_yield * peak
        p = xp.where(p > 0.0, p, 1.0)
        backbone = p / power(1.0 + power(p, self.sharpness), 1.0 / self.sharpness)
        absorbed = memory["absorbed"] + memory["flag"] * change
        softened = xp.exp(-((peak / self.softening_displacement) ** 2)) / (1.0 + self.flag_damage * absorbed)
        side = xp.where(deformation > 0.0, 1.0, self.asymmetry)
        loading = side * backbone * softened * power(x / p, self.pinching)
        sign = xp.sign(deformation)
        # In the direction of the deformation the flag lies between λR and R.
        trial = sign * (memory["flag"] + 2.0 * change)
        return sign * clip(trial, self.flag_return * loading, loading)
