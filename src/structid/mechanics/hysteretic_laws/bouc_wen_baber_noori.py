"""Bouc–Wen–Baber–Noori law with parameters that do not depend on the mass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from structid.engine.array_module import namespace
from structid.mechanics.hysteresis import LONGEST_STEP, Law, hysteretic_rate, power
from structid.mechanics.hysteretic_laws.base import HystereticLaw, Memory, parameter
from structid.mechanics.hysteretic_laws.default_priors import ASYMMETRY, HARDENING, around, between, up_to
from structid.mechanics.runge_kutta import runge_kutta_4


class Prepared(NamedTuple):
    """The law in SI, for a mass of 1 kg, and the stiffness of its hysteretic part."""

    law: Law
    hysteretic: Any  # (1 − α) k [N/m]


@dataclass(frozen=True, eq=False)
class BoucWenLaw(HystereticLaw):
    """Bouc–Wen–Baber–Noori law of the model `BoucWen`, given by yield force and energies relative to F_y u_y.

    ::

        f = k [α d + (1 − α) z],    β + γ = u_y^(−n),   γ = γ* β,   u_y = F_y/k
        δ_ν, δ_η, p per absorbed energy F_y u_y;   ψ₀ and δ_ψ relative to u_y
    """

    word: ClassVar[str] = "bouc_wen"
    title: ClassVar[str] = "Bouc–Wen–Baber–Noori law"
    use: ClassVar[str] = "smooth loops with gradual loss of stiffness and strength"
    source: ClassVar[str] = "Bouc (1967); Wen (1976); Baber & Noori (1985); Foliente (1995)"
    accurate_move: ClassVar[float] = 0.02
    dissipative: ClassVar[bool] = False
    example: ClassVar[dict[str, float]] = {
        "stiffness": 10.0,
        "yield_force": 1.0,
        "hardening": 0.05,
        "exponent": 1.5,
        "gamma_ratio": 0.3,
        "zeta0": 0.7,
        "p": 0.3,
        "q": 0.2,
        "psi0": 0.3,
        "delta_nu": 0.03,
        "delta_eta": 0.03,
        "asymmetry": 0.8,
    }
    opensees: ClassVar[str] = "BoucWen and BWBN, see the page on models"

    yield_force: Any = parameter("yield force F_y of the undamaged law", around(0.8, 2.5), "N")
    hardening: Any = parameter(
        "final stiffness, relative to the initial stiffness, α",
        HARDENING,
        high=1.0,
        default=0.0,
        neutral=0.0,
        mechanism="hardening",
    )
    exponent: Any = parameter(
        "sharpness n of the yielding", around(1.0, 3.0, low=0.2, high=20.0), low=0.2, high=20.0, default=1.0
    )
    gamma_ratio: Any = parameter("shape of unloading, γ/β", between(-0.9, 0.9), low=-1.0, high=10.0, default=1.0)
    delta_nu: Any = parameter(
        "loss of strength per absorbed energy F_y u_y, δ_ν",
        up_to(0.3),
        default=0.0,
        neutral=0.0,
        mechanism="loss of strength with the energy",
    )
    delta_eta: Any = parameter(
        "loss of stiffness per absorbed energy F_y u_y, δ_η",
        up_to(0.3),
        default=0.0,
        neutral=0.0,
        mechanism="loss of stiffness with the energy",
    )
    asymmetry: Any = parameter(
        "negative strength, relative to the positive one, ρ",
        ASYMMETRY,
        default=1.0,
        neutral=1.0,
        mechanism="asymmetric strength",
    )
    zeta0: Any = parameter(
        "largest share of pinching, ζ₀", between(0.0, 0.97), high=0.999, default=0.0, neutral=0.0, mechanism="pinching"
    )
    p: Any = parameter("rate of pinching per absorbed energy F_y u_y, p", around(0.3, 10.0), default=1.0)
    q: Any = parameter(
        "force at which the pinching is largest, relative to the strength, q",
        between(0.0, 0.5),
        low=-1.0,
        high=1.0,
        default=0.1,
    )
    psi0: Any = parameter("width of the pinching, relative to u_y, ψ₀", around(0.3, 3.0), default=0.3)
    delta_psi: Any = parameter("growth of that width with the energy, δ_ψ", up_to(0.05), default=0.0, neutral=0.0)
    lambda_: Any = parameter("influence of ζ₁ on the width, λ", around(0.3, 3.0), default=0.3)

    def prepare(self, zero: Any) -> Prepared:
        """Return the law for a mass of 1 kg; see `HystereticLaw.prepare`."""
        u_y = self.yield_force / self.stiffness
        per_energy = 1.0 / (self.yield_force * u_y)
        beta = power(u_y, -self.exponent) / (1.0 + self.gamma_ratio)
        law = Law(
            alpha=self.hardening,
            beta=beta,
            gamma=self.gamma_ratio * beta,
            exponent=self.exponent,
            amplitude=1.0,
            delta_a=0.0,
            delta_nu=self._scaled(self.delta_nu, per_energy),
            delta_eta=self._scaled(self.delta_eta, per_energy),
            zeta0=self.zeta0,
            p=self.p * per_energy,
            q=self.q,
            psi0=self.psi0 * u_y,
            delta_psi=self._scaled(self.delta_psi, u_y * per_energy),
            lambda_=self.lambda_,
            asymmetry=self.asymmetry,
        )
        return Prepared(law, (1.0 - self.hardening) * self.stiffness)

    @staticmethod
    def _scaled(value: Any, scale: Any) -> Any:
        """Return a product, but a fixed zero as it is, so that its term is left out."""
        return value if isinstance(value, float) and value == 0.0 else value * scale

    def at_rest(self, zero: Any) -> Memory:
        """Return deformation, force, hysteretic displacement and absorbed energy; see `HystereticLaw.at_rest`."""
        return dict.fromkeys(("d", "f", "z", "e_h"), zero)

    def moved(self, prepared: Prepared, memory: Memory, deformation: Any) -> Memory:
        """Move the spring by one Runge–Kutta step; see `HystereticLaw.moved`."""
        law, hysteretic = prepared

        def rate(state: Memory, velocity: Any) -> Memory:
            z = state["z"]
            return {"z": hysteretic_rate(velocity, z, state["e_h"], law), "e_h": hysteretic * z * velocity}

        change = deformation - memory["d"]
        after: Memory = runge_kutta_4(rate, {"z": memory["z"], "e_h": memory["e_h"]}, (change, change, change), 1.0)
        force = self.hardening * self.stiffness * deformation + hysteretic * after["z"]
        return {"d": deformation, "f": force, **after}

    def longest_move(self) -> Any:
        """Return the move over which z loses its memory; see `HystereticLaw.longest_move`.

        1/|∂z′/∂z| = u_y min(1, ρ)ⁿ (1 + γ*)/(n (1 + |γ*|)) where |z| is largest
        """
        xp = namespace(self.yield_force)
        shape = (1.0 + self.gamma_ratio) / (1.0 + xp.abs(self.gamma_ratio))
        weaker = power(xp.minimum(self.asymmetry, 1.0), self.exponent)
        u_y = self.yield_force / self.stiffness
        return LONGEST_STEP * u_y * shape * weaker / xp.maximum(self.exponent, 1.0)
