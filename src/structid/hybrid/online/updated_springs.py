"""Springs of a numerical part whose law may change during a test."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from structid.core.validation import check_arguments
from structid.mechanics.hysteresis import Law
from structid.mechanics.restoring_forces import HystereticSprings, RestoringForce


@check_arguments
class UpdatedSprings(RestoringForce):
    """Springs that take over the law of a specimen like them. What they remember stays.

    Parameters
    ----------
    springs : HystereticSprings
        As they are at first.

    Examples
    --------
    >>> import structid as si
    >>> springs = si.UpdatedSprings(lower.force)  # doctest: +SKIP
    >>> online = si.UnscentedFilter(model, space, force_noise=200.0, updates=springs)  # doctest: +SKIP
    """

    def __init__(self, springs: HystereticSprings) -> None:
        self.springs = springs

    def adopt(self, specimen: HystereticSprings) -> None:
        """Take over stiffness and law.

        Parameters
        ----------
        specimen : HystereticSprings
            One spring, of one run.
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
        """As for the springs; see `RestoringForce.largest_move`."""
        return self.springs.largest_move

    @property
    def content_hash(self) -> str:
        """Hash of the springs in their current state."""
        return self.springs.content_hash

    def at_rest(self, displacement: Any) -> Any:
        """What is remembered before the first move; see `RestoringForce.at_rest`."""
        return self.springs.at_rest(displacement)

    def at(self, memory: Any, displacement: Any) -> tuple[Any, Any]:
        """Impose a displacement, by the law as it is now; see `RestoringForce.at`."""
        return self.springs.at(memory, displacement)
