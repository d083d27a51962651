"""Both parts as one linear structure: modes, the specimen's fraction of each modal stiffness, critical delay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from jaxtyping import Float

from structid.hybrid.control.delay import CriticalDelay, critical_delay_of, growing_oscillations
from structid.hybrid.coupling.base import Joined


@dataclass(frozen=True, eq=False)
class WholeStructure:
    """Matrices of both parts, tied at their interface, in the degrees of freedom of the whole structure."""

    mass: Float[np.ndarray, "dof dof"]  # M [kg]
    damping: Float[np.ndarray, "dof dof"]  # C [N s/m]
    numerical: Float[np.ndarray, "dof dof"]  # initial stiffness of the numerical part [N/m]
    physical: Float[np.ndarray, "dof dof"]  # initial stiffness of the physical part [N/m]

    @classmethod
    def of(cls, coupled: Joined) -> WholeStructure:
        """Tie both parts by restricting their displacements to Σ L u = 0."""
        sides = coupled.numerical, coupled.physical
        basis = scipy.linalg.null_space(np.concatenate([s.rows for s in sides], axis=1))
        maps = np.split(basis, [sides[0].part.dofs])

        def tied(name: str) -> np.ndarray:
            """A matrix of each part in these degrees of freedom, shape (part, dof, dof)."""
            return np.stack([z.T @ getattr(s.part, name) @ z for s, z in zip(sides, maps, strict=True)])

        return cls(tied("mass").sum(axis=0), tied("damping").sum(axis=0), *tied("stiffness"))

    @cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray]:
        """ω² and mass-orthonormal shapes."""
        squares, shapes = scipy.linalg.eigh(self.numerical + self.physical, self.mass)
        return np.maximum(squares, 0.0), shapes

    @property
    def frequencies(self) -> np.ndarray:
        """ω of every mode [rad/s], ascending."""
        return np.asarray(np.sqrt(self._modes[0]))

    @property
    def damping_ratios(self) -> np.ndarray:
        """ζ of every mode, from φᵀ C φ = 2 ζ ω."""
        shapes = self._modes[1]
        diagonal = np.einsum("im,ij,jm->m", shapes, self.damping, shapes)
        return np.asarray(diagonal / (2.0 * np.maximum(self.frequencies, np.finfo(float).tiny)))

    @property
    def shares(self) -> np.ndarray:
        """Fraction p of each modal stiffness that the specimen provides: φᵀ K_P φ / ω²."""
        squares, shapes = self._modes
        return np.asarray(
            np.einsum("im,ij,jm->m", shapes, self.physical, shapes) / np.maximum(squares, np.finfo(float).tiny)
        )

    @cached_property
    def critical_delay(self) -> CriticalDelay:
        """The shortest delay at which an oscillation no longer decays."""
        return critical_delay_of(self.mass, self.damping, self.numerical, self.physical)

    def growing_oscillations(self, factor: Callable[[float], complex]) -> int:
        """Count the growing oscillations if the specimen's force is multiplied by the loop factor G."""
        return growing_oscillations(self.mass, self.damping, self.numerical, self.physical, factor)
