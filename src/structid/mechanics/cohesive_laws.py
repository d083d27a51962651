"""Cohesive laws of a mortar joint: tractions and exact tangents of a normal and a tangential jump of displacement.

Sources: J. P. McGarry, É. Ó Máirtín, G. Parry & G. E. Beltz (2014, J. Mech. Phys. Solids 63, 336) for NP1, NP2 and SMC; X.-P. Xu &
A. Needleman (1993, Modelling Simul. Mater. Sci. Eng. 1, 111) for the potential from which they come. Numbers in brackets, such as
[5.1], are equations of the MSc thesis in docs/bibliography.md.

In separation the law is SMC, in over-closure NP2. Neither has a memory: a joint that has opened heals when it closes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from structid.array_module import namespace

COUPLING = float(np.sqrt(2.0) - 1.0)
"""a = b of NP2, with which both components are equal at 45° [5.1]."""


class CohesiveLaw(NamedTuple):
    """Stiffnesses at the origin and characteristic lengths; each a float, or an array over runs.

    Parameters
    ----------
    normal_stiffness, tangential_stiffness : float or array
        k_n = σ_max e / δ_n and k_t = τ_max e / δ_t [Pa/m].
    normal_length, tangential_length : float or array
        δ_n and δ_t [m].
    """

    normal_stiffness: Any
    tangential_stiffness: Any
    normal_length: Any
    tangential_length: Any


class JointResponse(NamedTuple):
    """Tractions [Pa] and their derivatives [Pa/m]: ``nt`` is ∂T_n/∂Δ_t.

    Parameters
    ----------
    normal, tangential : array
        T_n and T_t.
    nn, nt, tn, tt : array
        The tangent, which is not symmetric.
    """

    normal: Any
    tangential: Any
    nn: Any
    nt: Any
    tn: Any
    tt: Any


def cohesive_law(
    normal_energy: Any,
    normal_strength: Any,
    tangential_energy: Any,
    tangential_strength: Any,
    characteristic_length: str = "exponential",
) -> CohesiveLaw:
    """Make the law of energies and strengths: δ_n = φ_n / (σ_max e), δ_t = φ_t / (τ_max e).

    Parameters
    ----------
    normal_energy, tangential_energy : float or array
        Works of separation φ_n and of sliding φ_t [N/m].
    normal_strength, tangential_strength : float or array
        σ_max and τ_max [Pa].
    characteristic_length : {"exponential", "xu-needleman"}
        The second one takes the printed δ_t = φ_t / (τ_max √(e/2)), which belongs to a Gaussian law: the work of sliding is then
        2.33164 φ_t.

    Returns
    -------
    CohesiveLaw
        In SI.
    """
    normal_length = normal_energy / (normal_strength * np.e)
    tangential_length = tangential_energy / (
        tangential_strength * (np.e if characteristic_length == "exponential" else np.sqrt(0.5 * np.e))
    )
    return CohesiveLaw(
        normal_strength * np.e / normal_length,
        tangential_strength * np.e / tangential_length,
        normal_length,
        tangential_length,
    )


def smc_np2(law: CohesiveLaw, opening: Any, slip: Any) -> JointResponse:
    """SMC in separation, NP2 in over-closure [5.1]-[5.4].

    With x = Δ_n/δ_n, y = |Δ_t|/δ_t and ρ = √(x² + y²), where k_n Δ_n = σ_max e x and k_t Δ_t = ± τ_max e y::

        Δ_n ≥ 0:  T_n = k_n Δ_n exp(−ρ)          T_t = k_t Δ_t exp(−ρ)
        Δ_n < 0:  T_n = k_n Δ_n exp(−x − a y)    T_t = k_t Δ_t exp(−y − b x)        a = b = √2 − 1

    Parameters
    ----------
    law : CohesiveLaw
        The parameters.
    opening, slip : array
        Δ_n and Δ_t [m].

    Returns
    -------
    JointResponse
        Where Δ_n = 0 and Δ_t ≠ 0 the tractions are continuous and the tangents are not: it is that of separation.
    """
    xp = namespace(opening)
    k_n, k_t, d_n, d_t = law
    x, y, side = opening / d_n, xp.abs(slip) / d_t, xp.sign(slip)
    square = x * x + y * y
    away = square > 0.0
    rho = xp.sqrt(xp.where(away, square, 1.0))  # its derivative is finite at the origin
    apart = opening >= 0.0
    decay = xp.where(away, rho, 0.0)
    e_n = xp.exp(-xp.where(apart, decay, x + COUPLING * y))
    e_t = xp.exp(-xp.where(apart, decay, y + COUPLING * x))
    # ∂ρ/∂Δ_n = x/(δ_n ρ), ∂ρ/∂Δ_t = ± y/(δ_t ρ), both taken as zero at the origin.
    by_n, by_t = xp.where(away, x / rho, 0.0), xp.where(away, y / rho, 0.0)
    return JointResponse(
        k_n * opening * e_n,
        k_t * slip * e_t,
        k_n * e_n * (1.0 - x * xp.where(apart, by_n, 1.0)),
        -k_n * opening * e_n * side / d_t * xp.where(apart, by_t, COUPLING),
        -k_t * slip * e_t / d_n * xp.where(apart, by_n, COUPLING),
        k_t * e_t * (1.0 - y * xp.where(apart, by_t, 1.0)),
    )
