"""Cohesive laws of a mortar joint: tractions and exact tangents for a normal and a tangential displacement jump.

Sources: J. P. McGarry, É. Ó Máirtín, G. Parry & G. E. Beltz (2014, J. Mech. Phys. Solids 63, 336) for NP1, NP2 and SMC; X.-P. Xu &
A. Needleman (1993, Modelling Simul. Mater. Sci. Eng. 1, 111) for the underlying potential. Numbers in brackets, such as
[5.1], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.array_module import namespace

ROUNDING = 1e-10
"""Relative tolerance of κ and of the friction limit, which prevents damage or sliding from rounding errors."""
COUPLING = math.sqrt(2.0) - 1.0
"""Coefficients a = b of NP2, for which both traction components are equal at 45° [5.1]."""


class CohesiveLaw(NamedTuple):
    """Parameters of a cohesive law: stiffnesses, characteristic lengths and friction; floats or arrays over runs."""

    normal_stiffness: Any  # k_n = σ_max e / δ_n [Pa/m]
    tangential_stiffness: Any  # k_t = τ_max e / δ_t [Pa/m]
    normal_length: Any  # δ_n [m]
    tangential_length: Any  # δ_t [m]
    friction: Any = 0.0  # μ, for a joint law with friction


class JointResponse(NamedTuple):
    """Tractions [Pa] and their derivatives [Pa/m]: ``nt`` is ∂T_n/∂Δ_t."""

    normal: Any  # T_n
    tangential: Any  # T_t
    nn: Any  # ∂T_n/∂Δ_n; the tangent is not symmetric
    nt: Any  # ∂T_n/∂Δ_t
    tn: Any  # ∂T_t/∂Δ_n
    tt: Any  # ∂T_t/∂Δ_t


def cohesive_law(
    normal_energy: Any,
    normal_strength: Any,
    tangential_energy: Any,
    tangential_strength: Any,
    characteristic_length: str = "exponential",
    friction: Any = 0.0,
) -> CohesiveLaw:
    """Compute the cohesive law from energies and strengths: δ_n = φ_n / (σ_max e), δ_t = φ_t / (τ_max e)."""
    normal_length = normal_energy / (normal_strength * math.e)
    tangential_length = tangential_energy / (
        tangential_strength * (math.e if characteristic_length == "exponential" else math.sqrt(0.5 * math.e))
    )
    return CohesiveLaw(
        normal_strength * math.e / normal_length,
        tangential_strength * math.e / tangential_length,
        normal_length,
        tangential_length,
        friction,
    )


class JointLaw(ABC):
    """Constitutive law of a joint: tractions from displacement jumps, with a memory of earlier jumps."""

    memories: ClassVar[int]  # number of memory variables of a joint
    load_steps: ClassVar[int]  # number of steps of the static load; it affects a joint with memory

    @abstractmethod
    def respond(self, law: CohesiveLaw, memory: Float[Array, "memory ..."], opening: Any, slip: Any) -> JointResponse:
        """Compute tractions and tangents."""

    def remembered(
        self, law: CohesiveLaw, memory: Float[Array, "memory ..."], opening: Any, slip: Any
    ) -> Float[Array, "memory ..."]:
        """Compute the memory after a step."""
        return memory


class SmcNp2(JointLaw):
    """Joint law: SMC in separation, NP2 in over-closure [5.1]-[5.4]. Without memory, an open joint heals on closing.

    The tractions depend on x = Δ_n/δ_n, y = |Δ_t|/δ_t and ρ = √(x² + y²); k_n Δ_n = σ_max e x and k_t Δ_t = ± τ_max e y::

        Δ_n ≥ 0:  T_n = k_n Δ_n exp(−ρ)          T_t = k_t Δ_t exp(−ρ)
        Δ_n < 0:  T_n = k_n Δ_n exp(−x − a y)    T_t = k_t Δ_t exp(−y − b x)        a = b = √2 − 1
    """

    memories, load_steps = 0, 1

    def respond(self, law: CohesiveLaw, memory: Any, opening: Any, slip: Any) -> JointResponse:
        """Compute tractions and tangents; see `JointLaw.respond`."""
        xp = namespace(opening)
        x, y, side = opening / law.normal_length, xp.abs(slip) / law.tangential_length, xp.sign(slip)
        apart, (rho, by_n, by_t) = opening >= 0.0, _distance(xp, x, y)
        e_n = xp.exp(-xp.where(apart, rho, x + COUPLING * y))
        e_t = xp.exp(-xp.where(apart, rho, y + COUPLING * x))
        normal, tangential = law.normal_stiffness * opening * e_n, law.tangential_stiffness * slip * e_t
        return JointResponse(
            normal,
            tangential,
            law.normal_stiffness * e_n * (1.0 - x * xp.where(apart, by_n, 1.0)),
            -normal * side / law.tangential_length * xp.where(apart, by_t, COUPLING),
            -tangential / law.normal_length * xp.where(apart, by_n, COUPLING),
            law.tangential_stiffness * e_t * (1.0 - y * xp.where(apart, by_t, 1.0)),
        )


class DamageFriction(JointLaw):
    """Joint law: SMC with damage, unloading to the origin, undamaged contact, friction in the damaged, closed joint.

    κ is the largest ρ so far, where ρ = √(x² + y²) with x = ⟨Δ_n⟩/δ_n, and D = 1 − exp(−κ)::

        T_n = (1 − D) k_n Δ_n  in separation,  k_n Δ_n  in closure
        T_t = (1 − D) k_t Δ_t + D T_f,    T_f = k_t (Δ_t − Δ_p),    |T_f| ≤ μ ⟨−T_n⟩

    While κ grows in separation, this law gives the tractions of SMC. The dissipation is ½ (k_n Δ_n² + k_t Δ_t²) exp(−κ)
    κ′ plus the frictional dissipation. The memory contains κ and the slip Δ_p, from which the friction force is
    measured.
    """

    memories, load_steps = 2, 4

    def respond(self, law: CohesiveLaw, memory: Float[Array, "2 ..."], opening: Any, slip: Any) -> JointResponse:
        """Compute tractions and tangents; see `JointLaw.respond`."""
        xp = namespace(opening)
        kappa, slipped = memory[0], memory[1]
        k_n, k_t = law.normal_stiffness, law.tangential_stiffness
        apart = opening >= 0.0
        x, y = xp.where(apart, opening, 0.0) / law.normal_length, xp.abs(slip) / law.tangential_length
        rho, by_n, by_t = _distance(xp, x, y)
        grows = rho > (1.0 + ROUNDING) * kappa
        left = xp.exp(-xp.where(grows, rho, kappa))  # 1 − D
        # ∂(1 − D)/∂Δ_n and ∂(1 − D)/∂Δ_t, while κ grows.
        left_n = xp.where(grows & apart, -left * by_n / law.normal_length, 0.0)
        left_t = xp.where(grows, -left * by_t * xp.sign(slip) / law.tangential_length, 0.0)
        normal = k_n * opening * xp.where(apart, left, 1.0)
        limit = law.friction * xp.where(apart, 0.0, -k_n * opening)
        tried = k_t * (slip - slipped)
        sticks = _sticks(xp, tried, limit)
        rubbed = xp.where(sticks, tried, xp.sign(tried) * limit)
        rubbed_n = xp.where(sticks | apart, 0.0, -xp.sign(tried) * law.friction * k_n)
        rubbed_t = xp.where(sticks, k_t, 0.0)
        return JointResponse(
            normal,
            left * k_t * slip + (1.0 - left) * rubbed,
            xp.where(apart, k_n * (left + opening * left_n), k_n),
            xp.where(apart, k_n * opening * left_t, 0.0),
            left_n * (k_t * slip - rubbed) + (1.0 - left) * rubbed_n,
            left * k_t + left_t * (k_t * slip - rubbed) + (1.0 - left) * rubbed_t,
        )

    def remembered(
        self, law: CohesiveLaw, memory: Float[Array, "2 ..."], opening: Any, slip: Any
    ) -> Float[Array, "2 ..."]:
        """Compute κ and Δ_p after a step; see `JointLaw.remembered`."""
        xp = namespace(opening)
        kappa, slipped = memory[0], memory[1]
        apart, k_t = opening >= 0.0, law.tangential_stiffness
        x, y = xp.where(apart, opening, 0.0) / law.normal_length, xp.abs(slip) / law.tangential_length
        limit = law.friction * xp.where(apart, 0.0, -law.normal_stiffness * opening)
        tried = k_t * (slip - slipped)
        after = xp.where(_sticks(xp, tried, limit), slipped, slip - xp.sign(tried) * limit / k_t)
        return xp.stack([xp.maximum(kappa, _distance(xp, x, y)[0]), after])


def _sticks(xp: Any, tried: Any, limit: Any) -> Any:
    """Whether the joint sticks. A joint exactly at the friction limit sticks; a joint without compression does not."""
    return (limit > 0.0) & (xp.abs(tried) <= (1.0 + ROUNDING) * limit)


def _distance(xp: Any, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Return ρ = √(x² + y²), ∂ρ/∂x and ∂ρ/∂y; the derivatives are zero at the origin."""
    square = x * x + y * y
    away = square > 0.0
    rho = xp.sqrt(xp.where(away, square, 1.0))
    return xp.where(away, rho, 0.0), xp.where(away, x / rho, 0.0), xp.where(away, y / rho, 0.0)


JOINT_LAWS: dict[str, JointLaw] = {"smc-np2": SmcNp2(), "damage-friction": DamageFriction()}
"""Joint laws and their names in a study file."""
