"""A substructure: its matrices, its interface with the other part, and its restoring force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.mechanics.restoring_forces import LinearForce, RestoringForce


@check_arguments
@dataclass(frozen=True, eq=False)
class Substructure:
    """A numerical or a physical part of a structure.

        M a + C v + r(u) = −M ι a_g + Lᵀ Λ,

    where Λ are the forces of the other part at the interface. Mass and damping are numerical for a physical part too; only r(u)
    is measured.

    Parameters
    ----------
    mass, damping, stiffness : array-like, shape (dof, dof)
        M [kg], C [N s/m], and the initial stiffness K₀ [N/m]. K₀ must be the largest tangent stiffness; with a larger tangent
        stiffness, a step is unstable.
    interface : sequence of int or array-like, shape (interface, dof)
        Degrees of freedom that both parts share, numbered from 0, in the same order for both parts. If they share combinations
        of degrees of freedom, give the matrix L; the coupling adds the signs.
    restoring_force : RestoringForce, optional
        r(u); default: K₀ u.
    influence : array-like, shape (dof,), optional
        ι, displacement of each degree of freedom for a unit displacement of the base; default: 1 for all.
    name : str
        Name of the part, for messages.

    Examples
    --------
    >>> import structid as si
    >>> storey = si.Substructure([[6000.0]], [[29_318.0]], [[7.6e6]], interface=[0])
    >>> print(storey)
    Substructure: 1 degree of freedom, 1 at the interface, linear, to 5.664 Hz
    """

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    interface: Any
    restoring_force: RestoringForce | None = field(default=None, repr=False)
    influence: np.ndarray | None = None
    name: str = "substructure"

    def __post_init__(self) -> None:
        for what in ("mass", "damping", "stiffness"):
            object.__setattr__(self, what, self._matrix(what))
        count = len(self.mass)
        for what in ("damping", "stiffness"):
            if len(getattr(self, what)) != count:
                came = f"{len(getattr(self, what))} degrees of freedom, but the mass has {count}"
                raise InputError(f"{self.name}: {what}", came, "matrices of the same size")
        if np.linalg.eigvalsh(self.mass).min() <= 0.0:
            raise InputError(
                f"{self.name}: mass",
                "a matrix that is not positive definite",
                "a mass for every degree of freedom",
                "Reduce the part to the degrees of freedom with a mass; see reduced_by_guyan.",
            )
        object.__setattr__(self, "interface", self._interface(count))
        iota = np.ones(count) if self.influence is None else np.asarray(self.influence, dtype=np.float64)
        if iota.shape != (count,):
            raise InputError(f"{self.name}: influence", f"shape {iota.shape}", f"shape ({count},)")
        object.__setattr__(self, "influence", iota)
        force = LinearForce(self.stiffness) if self.restoring_force is None else self.restoring_force
        object.__setattr__(self, "restoring_force", force)

    def _matrix(self, what: str) -> np.ndarray:
        values = np.atleast_2d(np.asarray(getattr(self, what), dtype=np.float64))
        where = f"{self.name}: {what}"
        if values.ndim != 2 or values.shape[0] != values.shape[1] or not np.isfinite(values).all():
            raise InputError(where, f"an array of shape {values.shape}", "a square matrix of finite numbers")
        if not np.allclose(values, values.T, rtol=0.0, atol=1e-8 * np.abs(values).max()):
            raise InputError(where, "a matrix that is not symmetric", "a symmetric matrix")
        return values

    def _interface(self, count: int) -> np.ndarray:
        given = np.asarray(self.interface)
        where, allowed = f"{self.name}: interface", f"numbers from 0 to {count - 1}, or a matrix with {count} columns"
        if given.ndim == 2:
            if given.shape[1] != count:
                raise InputError(where, f"a matrix of shape {given.shape}", allowed)
            return np.asarray(given, dtype=np.float64)
        whole = given.size == 0 or np.issubdtype(given.dtype, np.integer)
        if given.ndim != 1 or not whole or not set(given.tolist()) <= set(range(count)) or len(set(given)) < len(given):
            raise InputError(where, f"{self.interface!r}", allowed, "Give each number once.")
        return np.asarray(np.eye(count)[given.astype(int)])

    @property
    def dofs(self) -> int:
        """Number of degrees of freedom."""
        return len(self.mass)

    @cached_property
    def base_load(self) -> np.ndarray:
        """−M ι, the load of a unit base acceleration, shape (dof,) [kg]."""
        return np.asarray(-self.mass @ self.influence)

    @property
    def force(self) -> RestoringForce:
        """Restoring force of the part."""
        assert self.restoring_force is not None  # set in __post_init__
        return self.restoring_force

    @property
    def linear(self) -> bool:
        """True if the restoring force is K₀ u."""
        return isinstance(self.force, LinearForce) and np.array_equal(self.force.stiffness, self.stiffness)

    def softened(self, share: float) -> Substructure:
        """The same part with a linear restoring force of a fraction of K₀, as after damage.

        Parameters
        ----------
        share : float
            Ratio K_t/K₀, 0 or more.

        Returns
        -------
        Substructure
            Part with the same K₀.
        """
        return replace(self, restoring_force=LinearForce(share * self.stiffness))

    def undamped(self) -> Substructure:
        """The same part without damping.

        Returns
        -------
        Substructure
            Part with C = 0.
        """
        return replace(self, damping=0.0 * self.damping)

    @cached_property
    def largest_frequency(self) -> float:
        """Largest natural frequency of the part with a free interface [rad/s]."""
        squares = scipy.linalg.eigh(self.stiffness, self.mass, eigvals_only=True)
        return float(np.sqrt(max(squares.max(), 0.0)))

    def __str__(self) -> str:
        many = "degree of freedom" if self.dofs == 1 else "degrees of freedom"
        kind = "linear" if self.linear else "nonlinear"
        hertz = self.largest_frequency / (2.0 * np.pi)
        return f"Substructure: {self.dofs} {many}, {len(self.interface)} at the interface, {kind}, to {hertz:.4g} Hz"


def proportional_damping(
    mass: Float[np.ndarray, "dof dof"],
    stiffness: Float[np.ndarray, "dof dof"],
    frequencies: Sequence[float],
    ratio: float,
) -> Float[np.ndarray, "dof dof"]:
    """Return the damping matrix a₀ M + a₁ K₀ of a part, from frequencies of the whole structure.

    ζ = ½ (a₀/ω + a₁ ω) at two frequencies; with a single frequency, a₀ = 0. All parts use the coefficients of the whole
    structure, so their damping matrices add up to its damping matrix.
    """
    if len(frequencies) == 1:
        return np.asarray(2.0 * ratio / frequencies[0] * stiffness)
    one, other = frequencies
    return np.asarray(2.0 * ratio / (one + other) * (one * other * mass + stiffness))
