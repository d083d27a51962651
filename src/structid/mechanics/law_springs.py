"""Springs with a hysteretic law under imposed displacements, as specimens of hybrid and cyclic tests."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.hashing import digest
from structid.engine.array_module import namespace
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.restoring_forces import RestoringForce

SHORT_MOVE = 0.05
"""Longest move of a smooth law that is imposed in one piece, relative to the length over which it loses its memory."""


@dataclass(frozen=True, eq=False)
class LawSprings(RestoringForce):
    """Springs between the degrees of freedom: r = Bᵀ f(d) with the deformations d = B u."""

    deformations: np.ndarray  # B, (spring, dof)
    law: HystereticLaw = field(repr=False)  # parameters: numbers, or arrays (spring, run)

    @property
    def dofs(self) -> int:
        """Number of displacements."""
        return int(self.deformations.shape[1])

    @property
    def content_hash(self) -> str:
        """Hash of the law and its parameters."""
        values = {f.name: np.asarray(getattr(self.law, f.name)).tolist() for f in fields(self.law)}
        return digest("LawSprings", self.deformations, self.law.word, values)

    @property
    def largest_move(self) -> float:
        """Largest move of a smooth law; infinite for a polygonal one; see `RestoringForce.largest_move`."""
        limit = float(np.min(self.law.longest_move()))
        return SHORT_MOVE * limit / float(np.abs(self.deformations).sum(axis=1).max())

    def at_rest(self, displacement: Float[Array, "dof *run"]) -> Any:
        """Return the memory of unmoved springs; see `RestoringForce.at_rest`."""
        return self.law.at_rest(0.0 * (self.deformations @ displacement))

    def at(self, memory: Any, displacement: Float[Array, "dof *run"]) -> tuple[Any, Any]:
        """Impose a displacement; see `RestoringForce.at`."""
        deformation = self.deformations @ displacement
        after = self.law.moved(self.law.prepare(0.0 * deformation), memory, deformation)
        xp = namespace(deformation)
        followed = xp.abs(deformation - memory["d"]) <= self.law.longest_move()
        return xp.where(followed.all(axis=0), self.deformations.T @ after["f"], xp.nan), after
