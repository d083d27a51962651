"""Settings that all shear frames have: damping, excitation, channels of the loops, values of the storeys in a study file."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from structid.core.errors import InputError, check_choice
from structid.core.keys import quantity
from structid.ground_motion.excitation import Excitation, check_one_signal


def check_damping(model: str, damping: str | np.ndarray, rayleigh_mode: int, storeys: int) -> None:
    """Refuse an unknown kind of damping matrix, a matrix of another size, and an impossible mode."""
    if isinstance(damping, str):
        check_choice(f"{model}.damping", damping, ("modal", "rayleigh"))
    elif np.shape(damping) != (storeys, storeys):
        raise InputError(f"{model}.damping", f"an array of shape {np.shape(damping)}", f"({storeys}, {storeys})")
    if rayleigh_mode < 1:
        raise InputError(f"{model}.rayleigh_mode", f"{rayleigh_mode}", "a mode number of 1 or more")


def check_frame_excitation(model: str, excitation: Excitation) -> None:
    """Refuse several signals at once, and imposed displacements."""
    check_one_signal(model, excitation)
    if excitation.kind == "displacement":
        raise InputError(model, "an imposed displacement", "a GroundMotion, or a ForceHistory on the top floor")


def loop_channels_of_storeys(numbers: Iterable[int]) -> dict[str, tuple[str, str, str]]:
    """Return drift, shear and absorbed energy of every storey."""
    return {f"storey {j}": (f"drift_{j}", f"restoring_force_{j}", f"absorbed_energy_{j}") for j in numbers}


def one_or_each(unit: str) -> Any:
    """Return the type of a key that has one number for all storeys, or one number for each storey."""
    one: Any = quantity(unit)
    return one | tuple.__class_getitem__((one, ...))
