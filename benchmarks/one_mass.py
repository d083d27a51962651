"""Hybrid test of one mass with a delayed specimen, for the benchmark and the tests: effect of the loop on the decay."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.compensation import Compensation
from structid.hybrid.control.transfer_system import Actuator
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.experiment import HybridTest
from structid.hybrid.hybrid_result import HybridResult
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.substructures.substructure import Substructure
from structid.mechanics.restoring_forces import LinearForce

STIFFNESS, MASS, RATIO, SCALE = 7.6e6, 12e3, 0.03, 10.0
OMEGA = float(np.sqrt(STIFFNESS / MASS))
PERIOD = 2.0 * np.pi / OMEGA


def one_mass_test(
    delay: float,
    compensation: Compensation | None = None,
    cycles: int = 12,
    substeps: int = 10,
    share: float = 1.0,
    **actuator: Any,
) -> HybridTest:
    """Share of the stiffness in the laboratory, half of mass and damping in each part, excitation by half a sine.

    A held command acts with a delay of whole controller steps, so the delay has as many controller steps as there are substeps.
    """
    c = 2.0 * RATIO * OMEGA * MASS
    upper = Substructure([[MASS / 2.0]], [[c / 2.0]], [[(1.0 - share) * STIFFNESS]], [0])
    lower = Substructure([[MASS / 2.0]], [[c / 2.0]], [[share * STIFFNESS]], [0])
    dt = delay / SCALE
    step = dt / substeps
    time = np.arange(round(cycles * PERIOD / dt) * substeps + 1) * step
    shaken = GroundMotion(np.where(time < PERIOD / 2.0, 3.0 * np.sin(OMEGA * time), 0.0), step)
    specimen = SimulatedSpecimen(
        LinearForce(lower.stiffness), Actuator(delay=delay, **actuator), controller_step=SCALE * step
    )
    coupling = PrakashHjelmstad(substeps, "physical")
    given: dict[str, Any] = {"coupling": coupling, "compensation": compensation, "physical": lower}
    return HybridTest(upper, specimen, shaken, dt=dt, time_scale=SCALE, **given)


def growth(result: HybridResult) -> float:
    """Logarithmic growth of the amplitude per cycle."""
    assert result.histories is not None
    part = result.histories.fine.part
    u = part.displacement[:, 0]
    top = np.flatnonzero((u[1:-1] > u[:-2]) & (u[1:-1] >= u[2:])) + 1
    top = top[(part.time[top] > 2.0 * PERIOD) & (u[top] > 0.02 * u.max())]
    return float(np.polyfit(part.time[top] / PERIOD, np.log(u[top]), 1)[0])
