"""A restoring force that has a past: what was imposed on it before, and where its zero is since then."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from structid.errors import InputError
from structid.hybrid.sequence import in_sequence
from structid.mechanics.restoring_forces import RestoringForce


@dataclass(frozen=True, eq=False)
class CarriedOver(RestoringForce):
    """r(u) of a structure that has gone a way and was then zeroed: displacements and forces count from its end.

    Parameters
    ----------
    force : RestoringForce
        Of the structure as it was at first.
    way : ndarray, shape (place, dof)
        Where it was moved to, one after the other; its last place is the new zero [m].
    """

    force: RestoringForce
    way: np.ndarray = field(repr=False)

    def __post_init__(self) -> None:
        way = np.asarray(self.way, dtype=np.float64)
        if way.ndim != 2 or not len(way) or not np.isfinite(way).all():
            raise InputError("CarriedOver.way", f"an array of shape {way.shape}", "(place, dof), finite, one or more")
        object.__setattr__(self, "way", way)

    @property
    def largest_move(self) -> float:
        """As of the structure; see `RestoringForce.largest_move`."""
        return self.force.largest_move

    def at_rest(self, displacement: Any) -> Any:
        """What is remembered at the end of the way; see `RestoringForce.at_rest`.

        Parameters
        ----------
        displacement : array, shape (dof,) or (dof, run)
            Zeros.

        Returns
        -------
        dict
            The structure's ``memory``, and the force ``at_zero``.
        """

        def move(memory: Any, row: tuple[Any]) -> tuple[Any, tuple[()]]:
            return self.force.at(memory, self._of(row[0], displacement))[1], ()

        memory = self.force.at_rest(displacement)
        if len(self.way) > 1:
            memory, _ = in_sequence(move, memory, (self.way[:-1],))
        at_zero, memory = self.force.at(memory, self._of(self.way[-1], displacement))
        return {"memory": memory, "at_zero": at_zero}

    def at(self, memory: Any, displacement: Any) -> tuple[Any, Any]:
        """Impose a displacement from the new zero; see `RestoringForce.at`.

        Parameters
        ----------
        memory : dict
            As `at_rest` gives it.
        displacement : array, shape (dof,) or (dof, run)
            u [m].

        Returns
        -------
        tuple
            The force without that at the new zero [N], and the memory after it.
        """
        force, after = self.force.at(memory["memory"], self._of(self.way[-1], displacement))
        return force - memory["at_zero"], {"memory": after, "at_zero": memory["at_zero"]}

    @staticmethod
    def _of(place: Any, displacement: Any) -> Any:
        """A place from the first zero, in the shape of what will come."""
        return displacement + (place if displacement.ndim == 1 else jax.numpy.asarray(place)[:, None])
