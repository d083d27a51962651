"""Wrappers of a restoring force: one starts after a displacement history, one divides displacement increments."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.engine.sequence import in_sequence
from structid.mechanics.restoring_forces import RestoringForce


@dataclass(frozen=True, eq=False)
class AroundAnother(RestoringForce):
    """A restoring force that wraps another restoring force with the same displacements."""

    force: RestoringForce  # the wrapped force

    @property
    def dofs(self) -> int:
        """Number of displacements."""
        return self.force.dofs

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of every displacement; see `RestoringForce.units`."""
        return self.force.units

    @property
    def largest_move(self) -> float:
        """Largest displacement increment of the wrapped force; see `RestoringForce.largest_move`."""
        return self.force.largest_move


@dataclass(frozen=True, eq=False)
class CarriedOver(AroundAnother):
    """Restoring force after a displacement path; displacements and forces are measured from the end of the path."""

    # Successive positions of the path; the last position is the new zero [m]
    way: np.ndarray = field(repr=False)

    def __post_init__(self) -> None:
        way = np.asarray(self.way, dtype=np.float64)
        if way.ndim != 2 or not len(way) or not np.isfinite(way).all():
            raise InputError("CarriedOver.way", f"an array of shape {way.shape}", "finite displacements (place, dof)")
        object.__setattr__(self, "way", way)

    def at_rest(self, displacement: Float[Array, "dof *run"]) -> Any:
        """Memory at the end of the path; see `RestoringForce.at_rest`."""

        def move(carried: tuple[Any, Any], row: tuple[Any]) -> tuple[tuple[Any, Any], tuple[()]]:
            force, after = self.force.at(carried[1], self._of(row[0], displacement))
            return (force, after), ()

        start = 0.0 * displacement, self.force.at_rest(displacement)
        (at_zero, memory), _ = in_sequence(move, start, (self.way,))
        return {"memory": memory, "at_zero": at_zero}

    def at(self, memory: Any, displacement: Float[Array, "dof *run"]) -> tuple[Any, Any]:
        """Impose a displacement measured from the new zero; see `RestoringForce.at`."""
        force, after = self.force.at(memory["memory"], self._of(self.way[-1], displacement))
        return force - memory["at_zero"], {"memory": after, "at_zero": memory["at_zero"]}

    @staticmethod
    def _of(displacement_before: Any, displacement: Any) -> Any:
        """Convert a displacement from the new zero to the original zero; its shape is unchanged."""
        return displacement + (
            displacement_before if displacement.ndim == 1 else jax.numpy.asarray(displacement_before)[:, None]
        )


@dataclass(frozen=True, eq=False)
class InPieces(AroundAnother):
    """A restoring force that divides every displacement increment into equal pieces.

    Large increments are then more accurate for a constitutive law that takes one Runge-Kutta step per increment.
    """

    pieces: int  # pieces per displacement increment

    @property
    def largest_move(self) -> float:
        """`pieces` times the largest increment of the wrapped force; see `RestoringForce.largest_move`."""
        return self.pieces * self.force.largest_move

    def force_at_rest(self, displacement: Float[Array, "dof *run"]) -> Any:
        """Force of the wrapped force before the first move; see `RestoringForce.force_at_rest`."""
        return self.force.force_at_rest(displacement)

    def at_rest(self, displacement: Float[Array, "dof *run"]) -> Any:
        """Memory before the first move; see `RestoringForce.at_rest`."""
        return {"memory": self.force.at_rest(displacement), "place": displacement}

    def at(self, memory: Any, displacement: Float[Array, "dof *run"]) -> tuple[Any, Any]:
        """Impose a displacement; see `RestoringForce.at`."""
        start, move = memory["place"], displacement - memory["place"]

        def piece(carried: tuple[Any, Any], row: tuple[Any]) -> tuple[tuple[Any, Any], tuple[()]]:
            return self.force.at(carried[1], start + row[0] * move), ()

        shares = (np.arange(1, self.pieces + 1) / self.pieces,)
        (force, after), _ = in_sequence(piece, (0.0 * displacement, memory["memory"]), shares)
        return force, {"memory": after, "place": displacement}
