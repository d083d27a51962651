"""Restoring forces of a substructure under imposed displacements: the static force and its memory.

Numbers in brackets, such as [3.13], are equations of the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError, StructidError
from structid.core.hashing import digest
from structid.core.validation import check_arguments
from structid.engine.array_module import namespace
from structid.mechanics.hysteresis import Law
from structid.mechanics.moved_springs import followed_by


class CollapseError(StructidError):
    """Error raised if a structure collapses under imposed displacements. The message gives the cause."""


class RestoringForce(ABC):
    """A static force r(u) of a substructure, which depends on its displacements and their history.

    The memory is an argument and a result, so a trial step can be discarded. A specimen in the laboratory allows no
    trial steps: it receives each displacement once, and its force is read once.
    """

    @property
    @abstractmethod
    def dofs(self) -> int:
        """Number of displacements."""

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of every displacement, ``"m"`` or ``"rad"``."""
        return ("m",) * self.dofs

    @property
    def largest_move(self) -> float:
        """Largest displacement increment that is imposed in one piece [m]."""
        return np.inf

    @property
    def content_hash(self) -> str:
        """Hash of all data on which the force depends."""
        return digest(type(self).__name__, *_arrays_of(self))

    def force_at_rest(self, displacement: Float[Array, "dof *run"]) -> Any:
        """Return the force before the first move, such as a permanent load; zero by default.

        Parameters
        ----------
        displacement : array, shape (dof,) or (dof, run)
            Zeros, in the shape of later displacements.

        Returns
        -------
        array
            Force in the shape of the displacement [N].
        """
        return displacement

    def begin(self, displacement: Float[Array, "dof *run"]) -> tuple[Any, Any]:
        """Return the force and the memory before the first move.

        Parameters
        ----------
        displacement : array, shape (dof,) or (dof, run)
            Zeros, in the shape of later displacements.

        Returns
        -------
        tuple
            Force and memory, as returned by `at`. A specimen is read once.
        """
        return self.force_at_rest(displacement), self.at_rest(displacement)

    @abstractmethod
    def at_rest(self, displacement: Float[Array, "dof *run"]) -> Any:
        """Return the memory before the first move.

        Parameters
        ----------
        displacement : array, shape (dof,) or (dof, run)
            Zeros, in the shape of later displacements.

        Returns
        -------
        tree of arrays
            The memory.
        """

    @abstractmethod
    def at(self, memory: Any, displacement: Float[Array, "dof *run"]) -> tuple[Any, Any]:
        """Impose a displacement.

        Parameters
        ----------
        memory : tree of arrays
            Memory of the earlier moves.
        displacement : array, shape (dof,) or (dof, run)
            u [m], or [rad] for a rotation.

        Returns
        -------
        tuple
            The force, in the shape of the displacement [N], and the memory after the move.
        """


@dataclass(frozen=True, eq=False)
class LinearForce(RestoringForce):
    """Linear restoring force r = K u."""

    stiffness: Float[np.ndarray, "dof dof"]  # K [N/m]

    @property
    def dofs(self) -> int:
        """Number of displacements."""
        return len(self.stiffness)

    def at_rest(self, displacement: Any) -> Any:
        """Return an empty memory; see `RestoringForce.at_rest`."""
        return ()

    def at(self, memory: Any, displacement: Float[Array, "dof *run"]) -> tuple[Any, Any]:
        """Impose a displacement; see `RestoringForce.at`."""
        return self.stiffness @ displacement, memory


@check_arguments
@dataclass(frozen=True, eq=False)
class HystereticSprings(RestoringForce):
    """Bouc-Wen-Baber-Noori springs between the degrees of freedom: r = Bᵀ k (α d + (1 − α) z) with the deformations d = B u."""

    deformations: np.ndarray  # B
    stiffness: np.ndarray  # initial stiffness k of every spring [N/m]
    mass: np.ndarray  # mass m by which the energies are divided [kg], as in `BoucWen`
    # α, β, γ, …: each is one number for all springs, or an array (spring,) or (spring, run); see `spring_law`
    law: Law = field(repr=False)

    def __post_init__(self) -> None:
        rows = np.atleast_2d(np.asarray(self.deformations, dtype=np.float64))
        object.__setattr__(self, "deformations", rows)
        for name in ("stiffness", "mass"):
            if isinstance(getattr(self, name), jax.Array):
                continue  # values of many runs inside JAX cannot be checked
            values = np.atleast_1d(np.asarray(getattr(self, name), dtype=np.float64))
            if (
                values.shape[:1] != (len(rows),)
                or values.ndim > 2
                or not (np.isfinite(values).all() and (values > 0.0).all())
            ):
                raise InputError(
                    f"HystereticSprings.{name}",
                    f"{getattr(self, name)!r}",
                    f"{len(rows)} positive numbers, one per spring",
                )
            object.__setattr__(self, name, values)

    @property
    def dofs(self) -> int:
        """Number of displacements."""
        return int(self.deformations.shape[1])

    @property
    def largest_move(self) -> float:
        """Increment for a Runge-Kutta error of 1e-9: 4 % of z_u, the largest z; see `RestoringForce.largest_move`."""
        shapes = float(np.max(np.abs(self.law.beta) + np.abs(self.law.gamma)))
        ultimate = (1.0 / shapes) ** (1.0 / float(np.min(self.law.exponent))) if shapes > 0.0 else np.inf
        ultimate *= min(1.0, float(np.min(self.law.asymmetry)))
        return 0.04 * ultimate / float(np.abs(self.deformations).sum(axis=1).max())

    def at_rest(self, displacement: Float[Array, "dof *run"]) -> Any:
        """Return the memory of unmoved springs; see `RestoringForce.at_rest`."""
        nothing = self.deformations @ displacement
        return {"d": nothing, "z": nothing, "e_h": nothing}

    def at(self, memory: Any, displacement: Float[Array, "dof *run"]) -> tuple[Any, Any]:
        """Impose a displacement; see `RestoringForce.at`."""
        deformation = self.deformations @ displacement
        law = Law(*(self._of_springs(value, deformation) for value in self.law))
        stiffness = self._of_springs(self.stiffness, deformation)
        per_mass = stiffness / self._of_springs(self.mass, deformation)
        springs = {"z": memory["z"], "e_h": memory["e_h"]}
        after, followed = followed_by(law, (1.0 - law.alpha) * per_mass, springs, deformation - memory["d"])
        # Bᵀ k [α d + (1 − α) z]                                                                      [3.13]
        force = self.deformations.T @ (stiffness * (law.alpha * deformation + (1.0 - law.alpha) * after["z"]))
        xp = namespace(force)
        return xp.where(followed, force, xp.nan), {"d": deformation, **after}

    @staticmethod
    def _of_springs(value: Any, like: Any) -> Any:
        """Return a value for every spring, with a run axis if there are several runs."""
        if isinstance(value, float) or like.ndim == 1 or np.ndim(value) == 2:
            return value
        return namespace(like).asarray(value).reshape(-1, 1)


def _arrays_of(settings: Any) -> list[np.ndarray]:
    """Return the field values of a dataclass as arrays, including those of nested dataclasses and tuples."""
    values = [getattr(settings, f.name) for f in fields(settings)] if is_dataclass(settings) else list(settings)
    result: list[np.ndarray] = []
    for value in values:
        result += _arrays_of(value) if isinstance(value, tuple) or is_dataclass(value) else [np.asarray(value)]
    return result


def spring_law(
    alpha: float | Sequence[float],
    beta: float | Sequence[float],
    gamma: float | Sequence[float],
    **others: float | Sequence[float],
) -> Law:
    """Return the parameters of a hysteretic law, by default without degradation and pinching."""
    given = dict.fromkeys(Law._fields, 0.0) | {"exponent": 1.0, "amplitude": 1.0, "asymmetry": 1.0} | others
    unknown = set(given) - set(Law._fields)
    if unknown:
        raise InputError("spring_law", f"'{unknown.pop()}'", ", ".join(Law._fields))
    given |= {"alpha": alpha, "beta": beta, "gamma": gamma}
    values = {name: np.asarray(value, dtype=np.float64) for name, value in given.items()}
    return Law(**{name: value if value.ndim else float(value) for name, value in values.items()})
