"""Substructures with few degrees of freedom: static condensation, and constraint modes with fixed-interface modes.

Sources: R. J. Guyan (1965) for the condensation, R. R. Craig & M. C. C. Bampton (1968) for the modes; see docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError
from structid.core.validation import check_arguments
from structid.hybrid.substructures.substructure import Substructure


class Matrices(NamedTuple):
    """Matrices of a linear part."""

    mass: Float[np.ndarray, "dof dof"]  # M [kg]
    damping: Float[np.ndarray, "dof dof"]  # C [N s/m]
    stiffness: Float[np.ndarray, "dof dof"]  # K [N/m]
    influence: Float[np.ndarray, " dof"]  # ι, displacements for a unit displacement of the base

    def onto(self, basis: Float[np.ndarray, "dof coordinate"]) -> Matrices:
        """Restrict the motion to u = T q: Tᵀ M T, Tᵀ C T, Tᵀ K T, and ι with M_r ι_r = Tᵀ M ι."""
        # Symmetric in exact arithmetic; rounding errors are large where stiff parts cancel.
        mass, damping, stiffness = (0.5 * (small + small.T) for small in (basis.T @ full @ basis for full in self[:3]))
        return Matrices(mass, damping, stiffness, np.linalg.solve(mass, basis.T @ self.mass @ self.influence))


def constraint_modes(stiffness: Float[np.ndarray, "dof dof"], kept: Sequence[int]) -> Float[np.ndarray, "dof kept"]:
    """Return the static displacements for a unit displacement of each kept degree of freedom: −K_ii⁻¹ K_ik."""
    kept = list(kept)
    count = len(stiffness)
    if len(set(kept)) < len(kept) or not set(kept) <= set(range(count)) or not kept:
        raise InputError("kept", f"{kept}", f"numbers from 0 to {count - 1}, each once")
    inner = np.setdiff1d(np.arange(count), kept)
    basis = np.zeros((count, len(kept)))
    basis[kept, np.arange(len(kept))] = 1.0
    if len(inner):
        held = stiffness[np.ix_(inner, inner)]
        if np.linalg.cond(held) > 1e14:
            raise InputError(
                "kept", f"{kept}: the part can move without force", "enough degrees of freedom to restrain the part"
            )
        basis[inner] = -np.linalg.solve(held, stiffness[np.ix_(inner, np.array(kept))])
    return basis


@check_arguments
def reduced_by_guyan(
    mass: np.ndarray,
    damping: np.ndarray,
    stiffness: np.ndarray,
    kept: Sequence[int],
    interface: Sequence[int],
    *,
    influence: np.ndarray | None = None,
    name: str = "substructure",
) -> Substructure:
    """Reduce a part to selected degrees of freedom; the other degrees of freedom follow statically.

    The stiffness is exact, the mass is approximate. Frequencies are too high, and high frequencies have the largest errors.

    Parameters
    ----------
    mass, damping, stiffness : array-like, shape (dof, dof)
        M [kg], C [N s/m] and K [N/m]; M may be positive semi-definite.
    kept : sequence of int
        Degrees of freedom to keep, numbered from 0.
    interface : sequence of int
        Kept degrees of freedom at the interface, by their numbers in the whole part.
    influence : array-like, shape (dof,), optional
        ι; default: 1 for all degrees of freedom.
    name : str
        Name of the part.

    Returns
    -------
    Substructure
        Reduced part, with its degrees of freedom in the order of `kept`.

    Examples
    --------
    >>> import structid as si
    >>> import numpy as np
    >>> chain = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    >>> part = si.reduced_by_guyan(np.diag([0.0, 0.0, 1.0]), 0.0 * chain, chain, kept=[2], interface=[2])
    >>> print(f"{part.stiffness[0, 0]:.6f}")
    0.333333
    """
    whole = _matrices(mass, damping, stiffness, influence)
    small = whole.onto(constraint_modes(whole.stiffness, kept))
    rows = [list(kept).index(dof) for dof in _among(interface, kept)]
    return Substructure(*small[:3], rows, influence=small.influence, name=name)


@check_arguments
def reduced_by_craig_bampton(
    mass: np.ndarray,
    damping: np.ndarray,
    stiffness: np.ndarray,
    interface: Sequence[int],
    modes: int,
    *,
    influence: np.ndarray | None = None,
    name: str = "substructure",
) -> Substructure:
    """Reduce a part to its interface and its lowest fixed-interface modes.

    Parameters
    ----------
    mass, damping, stiffness : array-like, shape (dof, dof)
        M [kg], C [N s/m] and K [N/m].
    interface : sequence of int
        Degrees of freedom at the interface, numbered from 0.
    modes : int
        Number of modes, 0 or more. Each mode has a mass of 1 kg.
    influence : array-like, shape (dof,), optional
        ι; default: 1 for all degrees of freedom.
    name : str
        Name of the part.

    Returns
    -------
    Substructure
        Reduced part: first the interface, then the modes in ascending order.

    Examples
    --------
    >>> import structid as si
    >>> import numpy as np
    >>> chain = np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])
    >>> part = si.reduced_by_craig_bampton(np.eye(3), 0.0 * chain, chain, interface=[0], modes=2)
    >>> whole = np.linalg.eigvalsh(chain)
    >>> np.allclose(np.linalg.eigvals(np.linalg.solve(part.mass, part.stiffness)).max(), whole.max())
    True
    """
    whole = _matrices(mass, damping, stiffness, influence)
    inner = np.setdiff1d(np.arange(len(whole.mass)), list(interface))
    if not 0 <= modes <= len(inner):
        raise InputError("modes", f"{modes!r}", f"a whole number from 0 to {len(inner)} (inner degrees of freedom)")
    held = np.ix_(inner, inner)
    fixed = np.zeros((len(whole.mass), modes))
    if modes:
        fixed[inner] = scipy.linalg.eigh(whole.stiffness[held], whole.mass[held], subset_by_index=[0, modes - 1])[1]
    small = whole.onto(np.hstack([constraint_modes(whole.stiffness, interface), fixed]))
    return Substructure(*small[:3], list(range(len(list(interface)))), influence=small.influence, name=name)


def _matrices(mass: object, damping: object, stiffness: object, influence: object) -> Matrices:
    """Check that the sizes agree."""
    given = [np.asarray(matrix, dtype=np.float64) for matrix in (mass, damping, stiffness)]
    count = len(given[2])
    if any(matrix.shape != (count, count) for matrix in given):
        raise InputError("matrices", ", ".join(str(m.shape) for m in given), "three square matrices of the same size")
    iota = np.ones(count) if influence is None else np.asarray(influence, dtype=np.float64)
    if iota.shape != (count,):
        raise InputError("influence", f"shape {iota.shape}", f"shape ({count},)")
    return Matrices(given[0], given[1], given[2], iota)


def _among(interface: Sequence[int], kept: Sequence[int]) -> Sequence[int]:
    if not set(interface) <= set(kept):
        raise InputError("interface", f"{list(interface)}", f"kept degrees of freedom only: {list(kept)}")
    return interface
