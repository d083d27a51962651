"""The undivided two-floor frame of the hybrid benchmark, by OpenSees' Newmark integration."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.hybrid.coupling.coupling_benchmark import DAMPING_RATIO, MASS, STIFFNESS, pulse

DT, STEPS = 0.01, 200


def displacements(ops: Any) -> np.ndarray:
    """Displacements of both floors at the end of every step, shape (step, floor) [m]; `ops` is ``openseespy.opensees``."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    for node in range(3):
        ops.node(node, 0.0)
    ops.fix(0, 1)
    ops.uniaxialMaterial("Elastic", 1, STIFFNESS)
    for node in (1, 2):
        ops.mass(node, MASS)
        ops.element("zeroLength", node, node - 1, node, "-mat", 1, "-dir", 1, "-doRayleigh", 1)
    omega = np.sqrt(ops.eigen("-fullGenLapack", 2)[0])
    ops.rayleigh(0.0, 0.0, 2.0 * DAMPING_RATIO / omega, 0.0)
    time = np.arange(0.0, (STEPS + 0.5) * DT, DT)
    ops.timeSeries("Path", 1, "-dt", DT, "-values", *map(float, pulse(time)), "-useLast")
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("FullGeneral")
    ops.algorithm("Linear")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    found = []
    for _ in range(STEPS):
        if ops.analyze(1, DT) != 0:
            raise RuntimeError("OpenSees did not complete a step")
        found.append([ops.nodeDisp(1, 1), ops.nodeDisp(2, 1)])
    ops.wipe()
    return np.array(found)
