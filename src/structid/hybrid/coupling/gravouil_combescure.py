"""The Gravouil-Combescure coupling: equal interface velocities at every fine step.

Source: A. Gravouil & A. Combescure (2001, Int. J. Numer. Meth. Eng. 50, 199).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.validation import check_arguments
from structid.engine.array_module import namespace
from structid.engine.sequence import in_sequence
from structid.hybrid.coupling.base import CoarseStep, CoupledState, Coupling, Joined, inverse_of, splittings
from structid.hybrid.coupling.operator_splitting import PartState
from structid.hybrid.substructures.substructure import Substructure


@check_arguments
@dataclass(frozen=True, eq=False)
class GravouilCombescure(Coupling):
    """Coupling with equal interface velocities of both parts at every fine step; α = 0.

    Part A takes a free step with Λ = 0. At every fine step j, part B takes a free step with Λ = 0. The interface forces are

        Λ_j = −H⁻¹ [(1 − j/ss) L_A v_A⁰ + (j/ss) L_A v_A¹ + L_B v_B],    H = Σ γ h_i L_i M̂_i⁻¹ L_iᵀ

    and B adds its linear response to Λ_j. v_A¹ is the free velocity of A at the end of the coarse step; at its start,
    v_A⁰ = v_A − γ Δt M̂_A⁻¹ L_Aᵀ Λ_n. After the last fine step, A adds its linear response to Λ_ss. The coupling is
    stable for any time step, even if a specimen on the fine step softens. For ss > 1 it is of first order, and it adds
    damping.

    Parameters
    ----------
    substeps : int
        ss, number of fine steps in a coarse step.
    fine : {"numerical", "physical"}
        Part that takes the fine steps.

    Examples
    --------
    >>> import structid as si
    >>> coupling = si.GravouilCombescure(substeps=10)
    >>> coupling.substeps
    10
    """

    def joined(self, numerical: Substructure, physical: Substructure, dt: float) -> JoinedAtFineSteps:
        """Couple two parts; see `Coupling.joined`."""
        coarse, fine = splittings(numerical, physical, dt, self)
        return JoinedAtFineSteps(coarse, fine, self.fine == "physical", self.substeps)


@dataclass(frozen=True, eq=False)
class JoinedAtFineSteps(Joined):
    """Two parts whose interface velocities agree at the end of every fine step; see `GravouilCombescure`."""

    @cached_property
    def inverse(self) -> np.ndarray:
        """H⁻¹, shape (interface, interface)."""
        return inverse_of(sum(s.rows @ s.unit_link.velocity for s in (self.coarse, self.fine)))

    def step(self, state: CoupledState, bases: Float[Array, " _"]) -> CoarseStep:
        """Take a coarse step; see `Joined.step`."""
        before, traction = self.parts_of(state), state.traction
        nothing, h = 0.0 * traction, self.fine.step
        coarse = self.coarse.free(before[0], bases[:: self.substeps], (nothing, nothing))
        at_start = self.coarse.rows @ (before[0].velocity - self.coarse.unit_link.velocity @ traction)
        at_end = self.coarse.rows @ coarse.velocity

        def step(carried: tuple[PartState, Any, Any], row: Any) -> tuple[tuple[PartState, Any, Any], Any]:
            (last, felt, works), (base, share) = carried, row
            fine = self.fine.free(last, base, (nothing, nothing))
            interface = (1.0 - share) * at_start + share * at_end
            now = -self.inverse @ (interface + self.fine.rows @ fine.velocity)
            fine = self.fine.unit_link.added_to(fine, now)
            work = ((self.fine.rows @ (fine.velocity - last.velocity)) * (now - felt)).sum(axis=0) / h
            return (fine, now, works + work), self.seen(fine, now)

        pairs = namespace(traction).stack([bases[:-1], bases[1:]], axis=1)
        begun = before[1], traction, 0.0 * traction[:1]
        (fine, now, works), within = in_sequence(step, begun, (pairs, self.shares))
        coarse = self.coarse.unit_link.added_to(coarse, now)
        gained = self.coarse.rows @ (coarse.velocity - before[0].velocity)
        work = (gained * (now - traction)).sum(axis=0) / self.dt
        return CoarseStep(self.state_of(coarse, fine, now), within, work + works[0])
