"""The Bouc-Wen-Baber-Noori law of a spring: hysteresis, degradation with absorbed energy, pinching.

Sources: Bouc (1967), Wen (1976, J. Eng. Mech. Div. 102, 249), Baber & Noori (1985, J. Eng. Mech. 111, 1010),
Foliente (1995, J. Struct. Eng. 121, 1013) for the pinching function.

Numbers in brackets, such as [3.4], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from structid.engine.array_module import namespace


class Law(NamedTuple):
    """Parameters of the hysteretic law; each parameter is an array over runs, or a float fixed at compile time.

    The exponent n is `exponent`, and A₀ is `amplitude`. The degradation rates are δ_A, δ_ν, δ_η [kg/J]. The pinching parameters
    are ζ₀, p, q, ψ₀, δ_ψ, λ. The asymmetry ρ is the strength for z < 0, relative to the strength for z > 0.
    """

    alpha: Any
    beta: Any
    gamma: Any
    exponent: Any
    amplitude: Any
    delta_a: Any
    delta_nu: Any
    delta_eta: Any
    zeta0: Any
    p: Any
    q: Any
    psi0: Any
    delta_psi: Any
    lambda_: Any
    asymmetry: Any = 1.0


def known(value: Any, number: float) -> bool:
    """Whether a parameter is fixed at a given value, so that its term can be omitted."""
    return isinstance(value, float) and value == number


def degrades(law: Law) -> bool:
    """Whether the hysteretic law depends on the absorbed hysteretic energy."""
    return not all(known(v, 0.0) for v in (law.delta_a, law.delta_nu, law.delta_eta, law.zeta0))


def power(base: Any, exponent: Any) -> Any:
    """Power of a non-negative base, with finite derivatives at zero."""
    if isinstance(exponent, float) and exponent.is_integer():
        return base if exponent == 1.0 else base ** int(exponent)
    xp = namespace(base)
    positive = base > 0.0
    return xp.where(positive, xp.exp(exponent * xp.log(xp.where(positive, base, 1.0))), 0.0)


def pinching(velocity: Any, z: Any, energy: Any, nu: Any, a: Any, law: Law) -> Any:
    """Pinching function h of the Baber-Noori law.

    h = 1 − ζ₁ exp(−(z sign(v) − q z_u)²/ζ₂²)                          [3.9]
    z_u = [A/(ν(β+γ))]^(1/n)                                           [3.10]
    ζ₁ = ζ₀ (1 − exp(−p e_h)),  ζ₂ = (ψ₀ + δ_ψ e_h)(λ + ζ₁)            [3.11]
    """
    xp = namespace(z)
    sum_of_shapes = nu * (law.beta + law.gamma)
    bounded = sum_of_shapes > 0.0
    ultimate = power(xp.maximum(a, 0.0) / xp.where(bounded, sum_of_shapes, 1.0), _inverse(law.exponent))
    if not known(law.asymmetry, 1.0):
        ultimate = xp.where(velocity < 0.0, law.asymmetry * ultimate, ultimate)
    zeta1 = law.zeta0 * (1.0 - xp.exp(-law.p * energy))
    zeta2 = (law.psi0 + law.delta_psi * energy) * (law.lambda_ + zeta1)
    h = 1.0 - zeta1 * xp.exp(-(((z * xp.sign(velocity) - law.q * ultimate) / zeta2) ** 2))
    return xp.where(bounded, h, 1.0)


def _inverse(exponent: Any) -> Any:
    return 1.0 if known(exponent, 1.0) else 1.0 / exponent


def law_rate(velocity: Any, z: Any, energy: Any, law: Law) -> Any:
    """Return an upper bound of |∂z′/∂z|, the rate at which the hysteretic displacement loses its memory.

    |∂z′/∂z| ≤ ν n (β + |γ|) |z|^(n−1) |v| / min(1, ρ)ⁿ;   pinching and η only reduce the rate
    """
    xp = namespace(velocity)
    rate = (law.beta + xp.abs(law.gamma)) * xp.abs(velocity)
    if not known(law.asymmetry, 1.0):
        rate = rate / power(xp.minimum(law.asymmetry, 1.0), law.exponent)
    if not known(law.exponent, 1.0):
        size = xp.abs(z)
        rate = rate * law.exponent * power(size, law.exponent) / xp.where(size > 0.0, size, 1.0)
    if energy is None or known(law.delta_nu, 0.0):
        return rate
    return rate * (1.0 + law.delta_nu * xp.maximum(energy, 0.0))


LONGEST_STEP = 1.5
"""Longest accurate integration step, relative to 1/|∂z′/∂z| and to 1/ω of the highest mode. For an imposed
displacement, the step is the increment relative to the characteristic length of the hysteretic force. In cyclic tests
with such steps the force error is below 1 % of the peak force (docs/theory/models.md). The Runge-Kutta method is
unstable for longer steps than 2.78 (Hairer & Wanner 1996, figure IV.2.1)."""


def hysteretic_rate(velocity: Any, z: Any, energy: Any, law: Law) -> Any:
    """Rate of the hysteretic displacement.

    z′ = h(z) { A v − ν [β |v| |z|^(n−1) z + γ v |z|ⁿ] } / η                     [3.4]
    A = A₀ − δ_A e_h,   ν = 1 + δ_ν e_h,   η = 1 + δ_η e_h                       [3.5]

    For z < 0 the shape uses z/ρ in place of z, so that the strength is ρ times as large.
    """
    xp = namespace(z)
    stretched = z if known(law.asymmetry, 1.0) else xp.where(z < 0.0, z / law.asymmetry, z)
    # Unlike |z|^(n−1) z, the equal expression sign(z) |z|ⁿ can be differentiated at z = 0, where the history starts.
    if known(law.exponent, 1.0):
        shape = law.beta * xp.abs(velocity) * stretched + law.gamma * velocity * xp.abs(stretched)
    else:
        shape = power(xp.abs(stretched), law.exponent) * (
            law.beta * xp.abs(velocity) * xp.sign(z) + law.gamma * velocity
        )
    if not degrades(law):
        return law.amplitude * velocity - shape
    a = law.amplitude - law.delta_a * energy
    nu = 1.0 + law.delta_nu * energy
    eta = 1.0 + law.delta_eta * energy
    rate = (a * velocity - nu * shape) / eta
    return rate if known(law.zeta0, 0.0) else pinching(velocity, z, energy, nu, a, law) * rate
