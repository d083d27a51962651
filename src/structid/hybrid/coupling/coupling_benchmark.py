"""A benchmark for couplings: two floors, with the lower storey as the physical part.

Each floor has 12 000 kg, each storey 7.6e6 N/m. The physical part is the lower storey with half of the first floor's
mass. Damping is (2ζ/ω₁) K₀ with ζ = 3 %. The ground acceleration is 3 sin²(π t / 0.5 s) m/s² for half a second.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.core.validation import check_arguments
from structid.hybrid.coupling.base import Coupling
from structid.hybrid.coupling.partitioned_run import PartitionedHistories, run_over
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.models.hysteretic.frame_equations import stiffness_matrix
from structid.models.hysteretic.shear_frame import ShearFrame

MASS, STIFFNESS, DAMPING_RATIO = 12_000.0, 7.6e6, 0.03
LAW = {"alpha": 0.05, "beta": 63.0, "gamma": 63.0, "delta_nu": 2.43, "delta_eta": 6.5}
"""Parameters of the constitutive law of both storeys in the hysteretic variant."""
PULSE, STRENGTH = 0.5, 3.0
"""Duration [s] and peak [m/s²] of the ground acceleration."""


def two_floor_frame(hysteretic: bool = False) -> ShearFrame:
    """Return the frame, not yet divided into parts."""
    law: dict[str, Any] = LAW if hysteretic else {"alpha": 1.0, "beta": 0.0, "gamma": 0.0}
    initial = stiffness_matrix(np.full(2, STIFFNESS))
    omega = np.sqrt(np.linalg.eigvalsh(initial / MASS)[0])
    damping = 2.0 * DAMPING_RATIO / omega * initial
    return ShearFrame(
        storeys=2,
        mass=MASS,
        stiffness=STIFFNESS,
        damping_ratio=DAMPING_RATIO,
        damping=damping,
        **law,
        channels=("displacement_1", "displacement_2"),
    )


def pulse(time: np.ndarray) -> np.ndarray:
    """Ground acceleration of the benchmark [m/s²]."""
    return np.where(time < PULSE, STRENGTH * np.sin(np.pi * time / PULSE) ** 2, 0.0)


@check_arguments
def two_floors(
    coupling: Coupling | None = None, *, hysteretic: bool = False, dt: float = 0.01, duration: float = 2.0
) -> PartitionedHistories:
    """Run the benchmark."""
    numerical, physical = cut_frame(two_floor_frame(hysteretic), 1, linear=not hysteretic)
    coupled = (PrakashHjelmstad() if coupling is None else coupling).joined(numerical, physical, dt)
    steps = round(duration / dt)
    return run_over(coupled, pulse(np.arange(steps * coupled.substeps + 1) * coupled.fine.step))
