"""Springs of a numerical part whose constitutive law may change during a test."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from structid.core.validation import check_arguments
from structid.mechanics.hysteresis import Law
from structid.mechanics.restoring_forces import HystereticSprings, RestoringForce


@check_arguments
class UpdatedSprings(RestoringForce):
    """Springs that adopt the constitutive law of a similar specimen and keep their own memory.

    Parameters
    ----------
    springs : HystereticSprings
        Initial springs.

    Examples
    --------
    >>> import structid as si
    >>> springs = si.UpdatedSprings(lower.force)  # doctest: +SKIP
    >>> online = si.UnscentedFilter(model, space, force_noise=200.0, updates=springs)  # doctest: +SKIP
    """

    def __init__(self, springs: HystereticSprings) -> None:
        self.springs = springs

    def adopt(self, specimen: HystereticSprings) -> None:
        """Adopt the stiffness and the constitutive law of a specimen.

        Parameters
        ----------
        specimen : HystereticSprings
            One spring for one run.
        """
        count = len(self.springs.deformations)
        law = Law(*(float(np.ravel(value)[0]) for value in specimen.law))
        self.springs = replace(self.springs, stiffness=np.full(count, float(np.ravel(specimen.stiffness)[0])), law=law)

    @property
    def dofs(self) -> int:
        """Number of displacements."""
        return self.springs.dofs

    @property
    def largest_move(self) -> float:
        """Largest move of the springs; see `RestoringForce.largest_move`."""
        return self.springs.largest_move

    @property
    def content_hash(self) -> str:
        """Hash of the springs in their current state."""
        return self.springs.content_hash

    def at_rest(self, displacement: Any) -> Any:
        """Return the memory of the springs before the first move; see `RestoringForce.at_rest`."""
        return self.springs.at_rest(displacement)

    def at(self, memory: Any, displacement: Any) -> tuple[Any, Any]:
        """Impose a displacement with the present constitutive law; see `RestoringForce.at`."""
        return self.springs.at(memory, displacement)
