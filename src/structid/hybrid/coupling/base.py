"""Interface of coupling methods, which make two parts move as one structure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError, check_choice
from structid.engine.array_module import namespace
from structid.hybrid.coupling.operator_splitting import OperatorSplitting, PartState
from structid.hybrid.substructures.substructure import Substructure

WORST_CONDITION = 1e14
"""Largest accepted condition number of an interface operator."""


class CoupledState(NamedTuple):
    """States of both parts at the end of a coarse step."""

    numerical: PartState  # numerical part
    physical: PartState  # physical part
    traction: Float[Array, "interface *run"]  # Λ, the forces of the physical part on the numerical one [N]


class FineSteps(NamedTuple):
    """States within a coarse step."""

    part: PartState  # the fine part after each of its steps; first axis: fine step
    traction: Float[Array, "fine_step interface"]  # Λ on the fine part [N]


class CoarseStep(NamedTuple):
    """A completed coarse step."""

    state: CoupledState  # state at its end
    fine: Any  # states of its fine steps; empty if they are not kept
    # Σ_i Σ_steps [v_i]ᵀ L_iᵀ [Λ] / h_i of both parts, with increments [·] [W/s]; zero if the interface forces do no work
    pseudo_energy: Any


@dataclass(frozen=True, eq=False)
class Coupling(ABC):
    """Coupling of two parts.

    Parameters
    ----------
    substeps : int
        ss, number of fine steps in a coarse step.
    fine : {"numerical", "physical"}
        Part that takes the fine steps.
    """

    substeps: int = 1
    fine: str = "numerical"

    def __post_init__(self) -> None:
        where = type(self).__name__
        if not isinstance(self.substeps, (int, np.integer)) or self.substeps < 1:
            raise InputError(f"{where}.substeps", f"{self.substeps!r}", "a whole number, 1 or more")
        check_choice(f"{where}.fine", self.fine, ("numerical", "physical"))

    @abstractmethod
    def joined(self, numerical: Substructure, physical: Substructure, dt: float) -> Joined:
        """Couple two parts.

        Parameters
        ----------
        numerical, physical : Substructure
            The parts.
        dt : float
            Coarse step Δt [s].

        Returns
        -------
        Joined
            The coupled structure.

        Raises
        ------
        InputError
            If the parts do not share an interface.
        """


@dataclass(frozen=True, eq=False)
class Joined(ABC):
    """Two coupled parts, which advance together by coarse steps."""

    coarse: OperatorSplitting  # part A, with the step Δt
    fine: OperatorSplitting  # part B, with ss steps of h = Δt/ss
    fine_is_physical: bool  # whether B is the physical part
    substeps: int  # ss
    keeps_fine: bool = True  # whether a step keeps the states of its fine steps

    @abstractmethod
    def step(self, state: CoupledState, bases: Float[Array, " _"]) -> CoarseStep:
        """Take a coarse step."""

    def of_parts(self, numerical: Substructure, physical: Substructure) -> Self:
        """Couple other parts in the same way, such as softened parts."""
        coarse, fine = (numerical, physical) if self.fine_is_physical else (physical, numerical)
        return replace(self, coarse=replace(self.coarse, part=coarse), fine=replace(self.fine, part=fine))

    def seen(self, part: PartState, traction: Float[Array, "interface *run"]) -> Any:
        """Return the data of a fine step, or an empty tuple if fine steps are not kept."""
        return FineSteps(part, traction) if self.keeps_fine else ()

    @property
    def guesses_for_specimen(self) -> bool:
        """Whether the specimen moves under predicted interface forces."""
        return False

    @property
    def numerical(self) -> OperatorSplitting:
        """Splitting of the numerical part."""
        return self.coarse if self.fine_is_physical else self.fine

    @property
    def physical(self) -> OperatorSplitting:
        """Splitting of the physical part."""
        return self.fine if self.fine_is_physical else self.coarse

    @property
    def dt(self) -> float:
        """Coarse step Δt [s]."""
        return self.coarse.step

    def parts_of(self, state: CoupledState) -> tuple[PartState, PartState]:
        """States of the coarse and the fine part."""
        pair = state.numerical, state.physical
        return pair if self.fine_is_physical else pair[::-1]

    def state_of(self, coarse: PartState, fine: PartState, traction: Any) -> CoupledState:
        """Combine the states of both parts."""
        pair = (coarse, fine) if self.fine_is_physical else (fine, coarse)
        return CoupledState(*pair, traction)

    def start(self, base: Any = 0.0, like: Float[Array, " run"] = None) -> CoupledState:
        """Return both parts at rest, with accelerations and interface forces for the first base acceleration.

        The condition Σ L a = 0 gives Λ: Σ L M⁻¹ Lᵀ Λ = −Σ L a, with accelerations a of the uncoupled parts on the right side.
        """
        sides = (self.coarse, self.fine)
        shapes = [np.zeros(s.part.dofs) if like is None else 0.0 * like + np.zeros((s.part.dofs, 1)) for s in sides]
        alone = [s.start(shape, base) for s, shape in zip(sides, shapes, strict=True)]
        pulls = [np.linalg.inv(s.part.mass) @ s.columns for s in sides]  # M⁻¹ Lᵀ
        operator = sum(s.rows @ pull for s, pull in zip(sides, pulls, strict=True))
        missed = sum(s.rows @ p.acceleration for s, p in zip(sides, alone, strict=True))
        traction = -inverse_of(operator) @ missed
        coarse, fine = (
            p._replace(acceleration=p.acceleration + pull @ traction) for p, pull in zip(alone, pulls, strict=True)
        )
        return self.state_of(coarse, fine, traction)

    def gap(self, state: CoupledState) -> Any:
        """Return the largest displacement mismatch at the interface; the coupling makes only velocities equal."""
        xp = namespace(state.traction)
        coarse, fine = self.parts_of(state)
        return xp.abs(self.coarse.rows @ coarse.displacement + self.fine.rows @ fine.displacement).max(axis=0)

    def missed_velocity(self, coarse: PartState, fine: PartState) -> Float[Array, "interface *run"]:
        """Velocity mismatch Σ L v at the interface."""
        return self.coarse.rows @ coarse.velocity + self.fine.rows @ fine.velocity

    @cached_property
    def shares(self) -> np.ndarray:
        """Fractions j/ss of the coarse step, shape (ss,)."""
        return np.arange(1, self.substeps + 1) / self.substeps


def splittings(
    numerical: Substructure, physical: Substructure, dt: float, coupling: Coupling, alpha: float = 0.0
) -> tuple[OperatorSplitting, OperatorSplitting]:
    """Return the splittings of the coarse and the fine part; L of the physical part has a negative sign."""
    rows = len(numerical.interface), len(physical.interface)
    if rows[0] != rows[1] or rows[0] == 0:
        raise InputError(
            "interface",
            f"{rows[0]} rows in {numerical.name}, {rows[1]} in {physical.name}",
            "the same number of rows in both parts, one or more",
            "Give the rows in the same order: row k of one part is connected to row k of the other part.",
        )
    if not (np.isfinite(dt) and dt > 0.0):
        raise InputError("dt", f"{dt!r}", "a positive time in seconds")
    signs = {"numerical": 1.0, "physical": -1.0}
    parts = {"numerical": numerical, "physical": physical}
    coarse = "physical" if coupling.fine == "numerical" else "numerical"
    return (
        OperatorSplitting(parts[coarse], dt, alpha, signs[coarse]),
        OperatorSplitting(parts[coupling.fine], dt / coupling.substeps, alpha, signs[coupling.fine]),
    )


def inverse_of(operator: Float[np.ndarray, "interface interface"]) -> Float[np.ndarray, "interface interface"]:
    """Invert an interface operator."""
    if np.linalg.cond(operator) > WORST_CONDITION:
        raise InputError(
            "interface",
            f"a singular interface operator (condition {np.linalg.cond(operator):.1e})",
            "linearly independent rows of L in each part",
            "Remove each row that repeats another row or has no mass.",
        )
    return np.asarray(np.linalg.inv(operator))
