"""A shear frame, divided at a floor into an upper and a lower part."""

from __future__ import annotations

import numpy as np

from structid.core.errors import InputError, check_choice
from structid.core.validation import check_arguments
from structid.hybrid.substructures.substructure import Substructure, proportional_damping
from structid.mechanics.hysteresis import Law
from structid.mechanics.restoring_forces import HystereticSprings
from structid.models.hysteretic.shear_frame import ShearFrame


@check_arguments
def cut_frame(
    frame: ShearFrame,
    floor: int,
    *,
    interface_share: float = 0.5,
    damping: str = "stiffness",
    linear: bool = False,
) -> tuple[Substructure, Substructure]:
    """Cut a frame at a floor into the storeys above it and the storeys below it; both parts share the floor.

    The damping matrix must be the sum of the parts' matrices, so modal damping is not available. Stiffness-proportional
    damping has the ratio ζ in the first mode. Rayleigh damping has this ratio in the first and the third mode, or in
    both modes of a frame with two storeys.

    Parameters
    ----------
    frame : ShearFrame
        Frame without free parameters.
    floor : int
        Number of the floor, from 1; not the top floor.
    interface_share : float
        Fraction of the floor's mass that belongs to the lower part, between 0 and 1.
    damping : {"stiffness", "rayleigh"}
        Kind of damping; ζ is the damping ratio of the frame.
    linear : bool
        Whether the springs keep their initial stiffness.

    Returns
    -------
    tuple of Substructure
        The upper part, whose first degree of freedom is the floor, and the lower part, whose last degree of freedom it is.

    Raises
    ------
    InputError
        If the frame has no such floor, or its parameters are free.

    Examples
    --------
    >>> import structid as si
    >>> frame = si.ShearFrame(storeys=2, mass=12e3, stiffness=7.6e6, alpha=0.05, beta=63.0, gamma=63.0, damping_ratio=0.03)
    >>> upper, lower = si.cut_frame(frame, 1)
    >>> print(lower)
    Substructure: 1 degree of freedom, 1 at the interface, nonlinear, to 5.664 Hz
    """
    if not 1 <= floor < frame.storeys:
        raise InputError("floor", f"{floor!r}", f"a whole number from 1 to {frame.storeys - 1}")
    if not 0.0 < interface_share < 1.0:
        raise InputError(
            "interface_share", f"{interface_share!r}", "a number between 0 and 1, so that both parts have mass"
        )
    check_choice("damping", damping, ("stiffness", "rayleigh"))
    values = frame.storey_values()
    mass, stiffness = (np.broadcast_to(values[name], frame.storeys) for name in ("mass", "stiffness"))
    omega = 2.0 * np.pi * frame.frequencies()
    chosen = [omega[0]] if damping == "stiffness" else [omega[0], omega[min(3, frame.storeys) - 1]]

    def part(name: str, storeys: slice, masses: np.ndarray, deformations: np.ndarray, interface: int) -> Substructure:
        k, matrix = stiffness[storeys], np.diag(masses)
        initial = deformations.T @ (k[:, None] * deformations)
        of_part = {n: values[n] if np.ndim(values[n]) == 0 else np.asarray(values[n])[storeys] for n in Law._fields}
        springs = HystereticSprings(deformations, k, mass[storeys], Law(**of_part))
        c = proportional_damping(matrix, initial, chosen, frame.damping_ratio)
        return Substructure(matrix, c, initial, [interface], None if linear else springs, name=name)

    below, above = mass[:floor].copy(), mass[floor - 1 :].copy()
    below[-1] *= interface_share
    above[0] *= 1.0 - interface_share
    drifts = np.eye(floor) - np.eye(floor, k=-1)
    between = np.eye(frame.storeys - floor, frame.storeys - floor + 1, k=1) - np.eye(
        frame.storeys - floor, frame.storeys - floor + 1
    )
    return (
        part("upper storeys", slice(floor, None), above, between, 0),
        part("lower storeys", slice(None, floor), below, drifts, floor - 1),
    )
