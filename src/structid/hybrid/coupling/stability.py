"""Stability of a coupling: its amplification matrix, and frequencies and damping of free oscillations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.hybrid.coupling.base import CoupledState, Joined
from structid.hybrid.coupling.operator_splitting import PartState

STILL = 1e-6
"""Smallest magnitude and imaginary part of an eigenvalue that belongs to an oscillation."""


class FreeOscillations(NamedTuple):
    """Free oscillations of a coupled structure, as its integrator computes them."""

    frequencies: Float[np.ndarray, " mode"]  # [rad/s], ascending
    damping_ratios: Float[np.ndarray, " mode"]  # ζ; negative for a growing oscillation


def amplification(coupled: Joined) -> Float[np.ndarray, "state state"]:
    """Return the amplification matrix, which maps the state of linear parts over one coarse step."""
    sizes = [s.part.dofs for s in (coupled.numerical, coupled.physical) for _ in range(4)]
    units = np.split(np.eye(sum(sizes) + len(coupled.coarse.rows)), np.cumsum(sizes))
    numerical, physical = (PartState(u, v, a, r, u, r, ()) for u, v, a, r in (units[:4], units[4:8]))
    after = coupled.step(CoupledState(numerical, physical, units[8]), np.zeros(coupled.substeps + 1)).state
    return np.concatenate([*after.numerical.linear(), *after.physical.linear(), after.traction])


def spectral_radius(coupled: Joined) -> float:
    """Return the largest absolute eigenvalue of the amplification matrix; 1 or less if the coupling is stable."""
    return float(np.abs(np.linalg.eigvals(amplification(coupled))).max())


def free_oscillations(coupled: Joined) -> FreeOscillations:
    """Return frequencies and damping ratios of oscillations: for an eigenvalue e^s, ω Δt = |s| and ζ = −Re s/|s|."""
    values = np.linalg.eigvals(amplification(coupled))
    values = values[(values.imag > STILL) & (np.abs(values) > STILL)]
    exponents = np.log(values)
    order = np.argsort(np.abs(exponents))
    sizes = np.abs(exponents[order])
    return FreeOscillations(sizes / coupled.dt, -exponents.real[order] / sizes)
