"""The Prakash-Hjelmstad coupling: equal interface velocities at coarse steps, linear interface forces between them.

Source: A. Prakash & K. D. Hjelmstad (2004, Int. J. Numer. Meth. Eng. 61, 2183). The prediction of interface forces for
a specimen on the fine step is an extension; see `PrakashHjelmstad`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.engine.array_module import namespace
from structid.engine.sequence import in_sequence
from structid.hybrid.coupling.base import CoarseStep, CoupledState, Coupling, Joined, inverse_of, splittings
from structid.hybrid.coupling.operator_splitting import Imposing, Link, PartState
from structid.hybrid.substructures.substructure import Substructure


@check_arguments
@dataclass(frozen=True, eq=False)
class PrakashHjelmstad(Coupling):
    """Coupling with equal interface velocities at the end of a coarse step; Λ is linear within it.

    1. Predict Λ*. Part A takes a free step under Λ*, part B takes ss free steps under Λ_n + (j/ss) (Λ* − Λ_n).
    2. Y = (u, v, a, r) of B after ss steps from rest under Λ = j/ss with K₀; H = (1+α) γ Δt L_A M̂_A⁻¹ L_Aᵀ + L_B Y_v.
    3. δΛ = −H⁻¹ Σ L v;  Λ = Λ* + δΛ;  A adds its linear response to δΛ, B adds Y δΛ.

    For linear parts, any prediction gives the same result. A nonlinear fine part, however, moves under Λ*, not under
    the corrected Λ. A virtual step without movement therefore predicts Λ* from Λ_n and the force r_last +
    K₀ (u − u_last). A softened specimen then has spurious damping; see `structid.hybrid.coupling.stability`.

    Parameters
    ----------
    substeps : int
        ss, number of fine steps in a coarse step.
    fine : {"numerical", "physical"}
        Part that takes the fine steps. A specimen on the fine step moves continuously, one controller step at a time. On the coarse
        step it moves by ramp and hold.
    alpha : float
        α from −1/3 to 0; negative values damp high frequencies.

    Examples
    --------
    >>> import structid as si
    >>> coupling = si.PrakashHjelmstad(substeps=10)
    >>> coupling.substeps
    10
    """

    alpha: float = 0.0

    def __post_init__(self) -> None:
        Coupling.__post_init__(self)
        if not -1.0 / 3.0 <= self.alpha <= 0.0:
            raise InputError("PrakashHjelmstad.alpha", f"{self.alpha:g}", "a number from -1/3 to 0")

    def joined(self, numerical: Substructure, physical: Substructure, dt: float) -> JoinedAtCoarseSteps:
        """Couple two parts; see `Coupling.joined`."""
        coarse, fine = splittings(numerical, physical, dt, self, self.alpha)
        virtual = not fine.part.linear and self.substeps > 1
        return JoinedAtCoarseSteps(coarse, fine, self.fine == "physical", self.substeps, virtual=virtual)


@dataclass(frozen=True, eq=False)
class JoinedAtCoarseSteps(Joined):
    """Two parts whose interface velocities agree at the end of every coarse step; see `PrakashHjelmstad`."""

    virtual: bool = False  # whether Λ* is predicted by a virtual step

    @property
    def guesses_for_specimen(self) -> bool:
        """Whether the specimen moves under predicted interface forces; see `Joined.guesses_for_specimen`."""
        return self.virtual and self.fine_is_physical

    @cached_property
    def response(self) -> Link:
        """Y: response of B, with stiffness K₀, to each interface force if it grows from 0 to 1 over ss steps."""
        linear = self.fine
        size = len(linear.rows)
        at_rest = np.zeros((linear.part.dofs, size))
        state = PartState(at_rest, at_rest, at_rest, at_rest, at_rest, at_rest, ())
        tractions = [share * np.eye(size) for share in (0.0, *self.shares)]
        for before, after in itertools.pairwise(tractions):
            state = linear.free(state, (0.0, 0.0), (before, after), linear.virtually(state))
        return Link(state.displacement, state.velocity, state.acceleration, state.force)

    @cached_property
    def inverse(self) -> np.ndarray:
        """H⁻¹, shape (interface, interface)."""
        return inverse_of(self.coarse.rows @ self.coarse.unit_link.velocity + self.fine.rows @ self.response.velocity)

    def step(self, state: CoupledState, bases: Float[Array, " _"]) -> CoarseStep:
        """Take a coarse step; see `Joined.step`."""
        before, traction = self.parts_of(state), state.traction
        guess = self._guessed(before, traction, bases) if self.virtual else traction
        coarse = self.coarse.free(before[0], bases[:: self.substeps], (traction, guess))
        fine, within = self._freely(before[1], bases, (traction, guess))
        change = -self.inverse @ self.missed_velocity(coarse, fine)
        coarse, fine = self.coarse.unit_link.added_to(coarse, change), self.response.added_to(fine, change)
        after = self.state_of(coarse, fine, guess + change)
        gained = self.missed_velocity(coarse, fine) - self.missed_velocity(*before)
        return CoarseStep(after, within, (gained * (after.traction - traction)).sum(axis=0) / self.dt)

    def _guessed(self, before: tuple[PartState, PartState], traction: Any, bases: Any) -> Any:
        """Return Λ*, predicted from Λ_n by a virtual step in which both parts respond linearly and nothing moves."""
        xp = namespace(traction)
        coarse, fine, shaking, pulling = self.foreseen
        shaken = shaking @ bases
        missed = coarse @ xp.concatenate(before[0][:4]) + fine @ xp.concatenate(before[1][:4]) + pulling @ traction
        return traction - self.inverse @ (missed + (shaken if missed.ndim == 1 else shaken[:, None]))

    @cached_property
    def foreseen(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Matrices that map (u, v, a, r) of A and B, the base acceleration and Λ_n to Σ L v after a virtual step."""
        sizes = [self.coarse.part.dofs] * 4 + [self.fine.part.dofs] * 4 + [self.substeps + 1, len(self.coarse.rows)]
        units = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])
        coarse, fine = (PartState(u, v, a, r, u, r, ()) for u, v, a, r in (units[:4], units[4:8]))
        bases, pair = units[8], (units[9], units[9])
        end_state = self.coarse.free(coarse, bases[:: self.substeps], pair, self.coarse.virtually(coarse))
        missed = self.missed_velocity(end_state, self._freely(fine, bases, pair, self.fine.virtually(fine))[0])
        ends = np.cumsum([sum(sizes[:4]), sum(sizes[4:8]), sizes[8]])
        whole = np.split(missed, ends, axis=1)
        return whole[0], whole[1], whole[2], whole[3]

    def _freely(
        self, state: PartState, bases: Any, tractions: tuple[Any, Any], imposing: Imposing | None = None
    ) -> tuple[PartState, Any]:
        """Take the fine steps of B under linearly changing interface forces."""
        first, change = tractions[0], tractions[1] - tractions[0]

        def step(carried: PartState, row: Any) -> tuple[PartState, Any]:
            base, share = row
            before, after = first + (share - 1.0 / self.substeps) * change, first + share * change
            next_state = self.fine.free(carried, base, (before, after), imposing)
            return next_state, self.seen(next_state, after)

        pairs = namespace(state.velocity).stack([bases[:-1], bases[1:]], axis=1)
        end_state: tuple[PartState, Any] = in_sequence(step, state, (pairs, self.shares))
        return end_state
