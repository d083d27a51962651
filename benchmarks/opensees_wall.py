"""The façade in OpenSees: the same blocks, beam, masses and loads, with nonlinear elastic, uncoupled joints."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from structid.mechanics.cohesive_laws import CohesiveLaw, JointLaw, JointResponse, SmcNp2
from structid.models.masonry.finite_elements.assembly import Assembly

REACH = 12.0
"""Characteristic lengths that the piecewise linear curves of the joints cover, with `POINTS` points on each side."""
POINTS = 120


class Uncoupled(JointLaw):
    """SMC and NP2 in pure opening and pure sliding, as piecewise linear curves that both programs can represent.

    Parameters
    ----------
    law : CohesiveLaw
        Cohesive law of the curves.
    """

    memories: ClassVar[int] = 0
    load_steps: ClassVar[int] = 1

    def __init__(self, law: CohesiveLaw) -> None:
        nothing, places = np.zeros((0, 1)), np.linspace(-REACH, REACH, 2 * POINTS + 1)
        # In closure the curve grows like exp(x): a few lengths are enough.
        self.openings = np.where(places < 0.0, 0.25, 1.0) * places * law.normal_length
        self.slips = places * law.tangential_length
        zeros = np.zeros_like(places)
        self.normal = SmcNp2().respond(law, nothing, self.openings, zeros).normal
        self.tangential = SmcNp2().respond(law, nothing, zeros, self.slips).tangential

    def respond(self, law: CohesiveLaw, memory: Any, opening: Any, slip: Any) -> JointResponse:
        """Tractions and slopes of the two curves; see `JointLaw.respond`."""
        normal, nn = _on_the_lines(self.openings, self.normal, opening)
        tangential, tt = _on_the_lines(self.slips, self.tangential, slip)
        return JointResponse(normal, tangential, nn, np.zeros_like(nn), np.zeros_like(nn), tt)


def _on_the_lines(places: np.ndarray, values: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    slopes = np.diff(values) / np.diff(places)
    segment = np.clip(np.searchsorted(places, at) - 1, 0, len(slopes) - 1)
    return values[segment] + slopes[segment] * (at - places[segment]), slopes[segment]


def build(ops: Any, assembly: Assembly, joints: Uncoupled) -> None:
    """Build the wall in OpenSees.

    Parameters
    ----------
    ops : module
        ``openseespy.opensees``.
    assembly : Assembly
        The wall.
    joints : Uncoupled
        Constitutive law of its joints.
    """
    mesh, masonry = assembly.mesh, assembly.masonry
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 2)
    for number, (x, y) in enumerate(mesh.nodes):
        ops.node(number + 1, float(x), float(y))
    for node in mesh.fixed:
        ops.fix(int(node) + 1, 1, 1)
    ops.nDMaterial("ElasticIsotropic", 1, masonry.modulus, masonry.poisson, masonry.density)
    for number, nodes in enumerate(mesh.blocks):
        ops.element(
            "quad",
            number + 1,
            *(int(n) + 1 for n in nodes),
            mesh.wall.thickness,
            "PlaneStress",
            1,
            0.0,
            masonry.density,
        )
    element = len(mesh.blocks)
    for number, joint in enumerate(mesh.joints):
        lower, upper = (face[int(np.argmax(joint.weights))] for face in (joint.lower, joint.upper))
        for direction, (places, values) in enumerate(
            ((joints.openings, joints.normal), (joints.slips, joints.tangential))
        ):
            ops.uniaxialMaterial(
                "ElasticMultiLinear",
                100 + 2 * number + direction,
                "-strain",
                *map(float, places),
                "-stress",
                *map(float, values * joint.area),
            )
        # Direction 1 is horizontal: tangential in a joint between courses, normal in a joint between neighbouring blocks.
        across = (1, 0) if joint.normal[1] else (0, 1)
        element += 1
        ops.element(
            "zeroLength",
            element,
            lower + 1,
            upper + 1,
            "-mat",
            *(100 + 2 * number + a for a in across),
            "-dir",
            1,
            2,
            "-doRayleigh",
            1,
        )
    ops.uniaxialMaterial("Elastic", 1, masonry.steel_modulus)
    for number, ((one, other), stiffness) in enumerate(zip(mesh.bars, assembly.bar_stiffness, strict=True)):
        element += 1
        if assembly.short_bars[number]:
            ops.uniaxialMaterial("Elastic", 10 + number, float(stiffness))
            ops.element(
                "zeroLength", element, int(one) + 1, int(other) + 1, "-mat", 10 + number, "-dir", 1, "-doRayleigh", 1
            )
        else:
            ops.element("Truss", element, int(one) + 1, int(other) + 1, masonry.steel_area, 1, "-doRayleigh", 1)
    for node, share in assembly.beam_shares(everywhere=True):
        ops.mass(node + 1, masonry.upper_mass * share, masonry.upper_mass * share)


def loaded(ops: Any, assembly: Assembly, extra: np.ndarray | None = None, steps: int = 10) -> None:
    """Apply the vertical load, and other forces, in steps.

    Parameters
    ----------
    ops : module
        ``openseespy.opensees``.
    assembly : Assembly
        The wall.
    extra : ndarray, shape (dof,), optional
        Further forces [N].
    steps : int
        Number of load steps.
    """
    forces = assembly.load if extra is None else extra
    tag = 1 if extra is None else 2
    ops.timeSeries("Linear", tag)
    ops.pattern("Plain", tag, tag)
    full = np.zeros(2 * len(assembly.mesh.nodes))
    full[assembly.mesh.free] = forces
    for node in np.flatnonzero(np.abs(full.reshape(-1, 2)).max(axis=1)):
        ops.load(int(node) + 1, *map(float, full[2 * node : 2 * node + 2]))
    ops.constraints("Plain")
    ops.numberer("RCM")
    ops.system("UmfPack")
    ops.test("NormDispIncr", 1e-12, 50)
    ops.algorithm("Newton")
    ops.integrator("LoadControl", 1.0 / steps)
    ops.analysis("Static")
    assert ops.analyze(steps) == 0
    ops.loadConst("-time", 0.0)


def shaken(ops: Any, base: np.ndarray, dt: float, a_0: float, a_1: float, node: int) -> np.ndarray:
    """Integrate by average acceleration with Rayleigh damping of the initial stiffness.

    Parameters
    ----------
    ops : module
        ``openseespy.opensees``.
    base : ndarray, shape (time,)
        Acceleration of the base [m/s²].
    dt : float
        Time step [s].
    a_0, a_1 : float
        Rayleigh coefficients of M and of the initial K.
    node : int
        Node whose horizontal displacement is recorded.

    Returns
    -------
    ndarray, shape (time,)
        Horizontal displacement of the node [m].
    """
    ops.wipeAnalysis()
    ops.timeSeries("Path", 9, "-dt", dt, "-values", *map(float, base), "-useLast")
    ops.pattern("UniformExcitation", 9, 1, "-accel", 9)
    ops.rayleigh(a_0, 0.0, a_1, 0.0)
    ops.constraints("Plain")
    ops.numberer("RCM")
    ops.system("UmfPack")
    ops.test("NormDispIncr", 1e-11, 50)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    found = [ops.nodeDisp(node + 1, 1)]
    for _ in range(len(base) - 1):
        assert ops.analyze(1, dt) == 0
        found.append(ops.nodeDisp(node + 1, 1))
    return np.array(found)
