"""α-operator splitting of one part: once per step, a displacement is imposed and the restoring force is read.

Sources: T. M. Hughes, K. S. Pister & R. L. Taylor (1979) for the splitting, H. M. Hilber, T. J. R. Hughes & R. L. Taylor (1977) for
α, D. Combescure & P. Pegon (1997) for both in a pseudo-dynamic test; see docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.hybrid.substructures.substructure import Substructure

Imposing = Callable[[Any, Any], tuple[Any, Any]]
"""Function ``imposing(memory, displacement) -> (force, memory)``, such as `RestoringForce.at`."""


class PartState(NamedTuple):
    """State of a part between two steps; arrays (dof,) or (dof, run)."""

    displacement: Any  # u
    velocity: Any  # v
    acceleration: Any  # a
    force: Any  # r, the restoring force at u in the splitting
    imposed: Any  # ũ, displacement of the last evaluation of the force
    reading: Any  # r̃, the force at ũ
    memory: Any  # memory of the restoring force

    def linear(self) -> tuple[Any, Any, Any, Any]:
        """Return the variables that determine the next step of a linear part: u, v, a, r."""
        return self.displacement, self.velocity, self.acceleration, self.force

    def recorded(self) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Return the recorded variables, in the order of `PartHistory`: all except the memory."""
        return *self.linear(), self.imposed, self.reading


class Link(NamedTuple):
    """Linear response of a part to changed interface forces; shape (dof,) or (dof, run); for unit forces (dof, interface)."""

    displacement: Any  # change of u
    velocity: Any  # change of v
    acceleration: Any  # change of a
    force: Any  # change of r

    def added_to(self, state: PartState, factor: Float[Array, "interface *run"] = 1.0) -> PartState:
        """Add the response to a state."""
        u, v, a, r = (x if isinstance(factor, float) else x @ factor for x in self)
        return state._replace(
            displacement=state.displacement + u,
            velocity=state.velocity + v,
            acceleration=state.acceleration + a,
            force=state.force + r,
        )


@dataclass(frozen=True, eq=False)
class OperatorSplitting:
    """α-operator splitting of one part with one step h: γ = ½ − α, β = (1 − α)²/4.

        ũ = u + h v + h² (½ − β) a        ṽ = v + h (1 − γ) a        r̃ = r(ũ)
        M̂ a₁ = (1+α) f₁ − α f₀ − (1+α) (C ṽ + r̃) + α (C v₀ + r₀) + Lᵀ [(1+α) Λ₁ − α Λ₀]
        M̂ = M + (1+α) (γ h C + β h² K₀)
        u₁ = ũ + β h² a₁        v₁ = ṽ + γ h a₁        r₁ = r̃ + K₀ (u₁ − ũ)

    Λ is averaged like the other forces; with Λ₁ alone, a coupled step with α ≠ 0 would be of first order. The method is
    stable for any h if all tangent stiffnesses are between 0 and K₀.
    """

    part: Substructure
    step: float  # h [s]
    alpha: float = 0.0  # α, from −1/3 to 0; negative values damp high frequencies
    sign: float = 1.0  # sign of the part's rows in Σ L v = 0

    @property
    def gamma(self) -> float:
        """γ = ½ − α."""
        return 0.5 - self.alpha

    @property
    def beta(self) -> float:
        """β = (1 − α)²/4."""
        return 0.25 * (1.0 - self.alpha) ** 2

    @cached_property
    def rows(self) -> np.ndarray:
        """L with its sign, shape (interface, dof)."""
        return self.sign * np.asarray(self.part.interface)

    @cached_property
    def columns(self) -> np.ndarray:
        """Lᵀ, shape (dof, interface)."""
        return np.ascontiguousarray(self.rows.T)

    @cached_property
    def inverse(self) -> np.ndarray:
        """M̂⁻¹, shape (dof, dof)."""
        h, part = self.step, self.part
        implicit = (1.0 + self.alpha) * (self.gamma * h * part.damping + self.beta * h**2 * part.stiffness)
        return np.linalg.inv(part.mass + implicit)

    @cached_property
    def unit_link(self) -> Link:
        """Response to a unit change of each interface force at the end of a step, from rest."""
        h = self.step
        a = (1.0 + self.alpha) * self.inverse @ self.columns
        u = self.beta * h**2 * a
        return Link(u, self.gamma * h * a, a, self.part.stiffness @ u)

    def start(self, displacement: Float[Array, "dof *run"], base: Any) -> PartState:
        """Return the state before the first step, without interface forces."""
        part = self.part
        force, memory = part.force.begin(displacement)
        acceleration = np.linalg.inv(part.mass) @ (self.load(base, displacement) - force)
        return PartState(displacement, displacement, acceleration, force, displacement, force, memory)

    def load(self, base: Any, like: Float[Array, "dof *run"]) -> Any:
        """−M ι a_g."""
        load = self.part.base_load
        return (load if like.ndim == 1 else load[:, None]) * base

    def free(
        self, state: PartState, bases: Any, tractions: tuple[Any, Any], imposing: Imposing | None = None
    ) -> PartState:
        """Take a step under known interface forces."""
        part, h, alpha = self.part, self.step, self.alpha
        u, v, a = state.displacement, state.velocity, state.acceleration
        predicted = u + h * v + h**2 * (0.5 - self.beta) * a
        rate = v + h * (1.0 - self.gamma) * a
        reading, memory = (imposing or part.force.at)(state.memory, predicted)
        base = (1.0 + alpha) * bases[1] - alpha * bases[0]
        traction = (1.0 + alpha) * tractions[1] - alpha * tractions[0]
        right = self.load(base, u) + self.columns @ traction - (1.0 + alpha) * (part.damping @ rate + reading)
        if alpha != 0.0:
            right = right + alpha * (part.damping @ v + state.force)
        acceleration = self.inverse @ right
        correction = self.beta * h**2 * acceleration
        return PartState(
            predicted + correction,
            rate + self.gamma * h * acceleration,
            acceleration,
            reading + part.stiffness @ correction,
            predicted,
            reading,
            memory,
        )

    def virtually(self, state: PartState) -> Imposing:
        """Return a function for the force r + K₀ (ũ − u) of a linear response from this state, without a movement."""
        force, displacement, stiffness = state.force, state.displacement, self.part.stiffness
        return lambda memory, imposed: (force + stiffness @ (imposed - displacement), memory)
