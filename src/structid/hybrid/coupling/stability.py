"""What a coupling does to free oscillations: its amplification matrix, frequencies and damping, and the limits that follow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from structid.hybrid.coupling.base import CoupledState, Joined
from structid.hybrid.coupling.operator_splitting import PartState

STILL = 1e-6
"""Of an eigenvalue that is one or real: nothing oscillates."""


class FreeOscillations(NamedTuple):
    """Oscillations of a coupled structure without load, as its integrator has them."""

    frequencies: Float[np.ndarray, " mode"]  # [rad/s], rising
    damping_ratios: Float[np.ndarray, " mode"]  # ζ; negative for an oscillation that grows


def amplification(joined: Joined) -> Float[np.ndarray, "state state"]:
    """Matrix by which a coarse step maps the state of linear parts, by taking it from unit states all at once."""
    sizes = [s.part.dofs for s in (joined.numerical, joined.physical) for _ in range(4)]
    units = np.split(np.eye(sum(sizes) + len(joined.coarse.rows)), np.cumsum(sizes))
    numerical, physical = (PartState(u, v, a, r, u, r, ()) for u, v, a, r in (units[:4], units[4:8]))
    after = joined.step(CoupledState(numerical, physical, units[8]), np.zeros(joined.substeps + 1)).state
    return np.concatenate([*after.numerical[:4], *after.physical[:4], after.traction])


def spectral_radius(joined: Joined) -> float:
    """Largest absolute eigenvalue of the amplification matrix; 1 or less where a coupling is stable."""
    return float(np.abs(np.linalg.eigvals(amplification(joined))).max())


def free_oscillations(joined: Joined) -> FreeOscillations:
    """Frequencies and damping of what oscillates: with an eigenvalue e^s, ω Δt = |s| and ζ = −Re s/|s|."""
    values = np.linalg.eigvals(amplification(joined))
    values = values[(values.imag > STILL) & (np.abs(values) > STILL)]
    exponents = np.log(values)
    order = np.argsort(np.abs(exponents))
    sizes = np.abs(exponents[order])
    return FreeOscillations(sizes / joined.dt, -exponents.real[order] / sizes)
