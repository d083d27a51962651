"""The façade against OpenSees: the same blocks, beam, loads and nonlinear elastic joints, pushed over and shaken.

OpenSees has no joint whose tractions depend on both jumps at once. So both programs get the curves of opening alone and of sliding
alone, as the same straight lines. Its quadrilaterals have their mass at the nodes, and so has the wall here.
"""

import sys
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

import structid as si
from structid.mechanics.cohesive_laws import cohesive_law
from structid.models.masonry.equations.dense_newton import DenseWall, simulate
from structid.models.masonry.finite_elements.assembly import Assembly, Masonry
from structid.models.masonry.finite_elements.layout import FACADE
from structid.models.masonry.finite_elements.mesh import mesh_of

try:  # without the system's libblas the package is there, and raises a RuntimeError
    import openseespy.opensees as ops
except (ImportError, RuntimeError) as error:
    pytest.skip(f"OpenSeesPy cannot be imported: {error}", allow_module_level=True)

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import opensees_wall

LAW = cohesive_law(3e3, 0.95e6, 2e5, 0.6e6)
JOINTS = opensees_wall.Uncoupled(LAW)


class Lumped(Assembly):
    """Mass at the nodes: the sums of the rows."""

    @cached_property
    def mass(self):
        consistent = Assembly(self.mesh, self.masonry).mass
        mesh, lumped = self.mesh, np.zeros(2 * len(self.mesh.nodes))
        for nodes in mesh.blocks:
            (x0, y0), (x1, y1) = mesh.nodes[nodes[0]], mesh.nodes[nodes[2]]
            own = 0.25 * self.masonry.density * mesh.wall.thickness * (x1 - x0) * (y1 - y0)
            lumped[2 * nodes] += own
            lumped[2 * nodes + 1] += own
        for node, share in self.beam_shares(everywhere=True):
            lumped[2 * node : 2 * node + 2] += self.masonry.upper_mass * share
        assert lumped[mesh.free].sum() == pytest.approx(consistent.sum(), rel=0.05)  # the fixed nodes have a part of it
        return np.diag(lumped[mesh.free])


ASSEMBLY = Lumped(mesh_of(FACADE), Masonry())
LEFT, RIGHT = (ASSEMBLY.mesh.corner(name) for name in ("top_left", "top_right"))


def test_loaded_and_pushed_over():
    opensees_wall.build(ops, ASSEMBLY, JOINTS)
    opensees_wall.loaded(ops, ASSEMBLY)
    wall = DenseWall(ASSEMBLY, JOINTS, LAW)
    u, memory = wall.loaded()
    theirs = [ops.nodeDisp(LEFT + 1, 1), ops.nodeDisp(LEFT + 1, 2), ops.nodeDisp(RIGHT + 1, 2)]
    ours = u[[ASSEMBLY.dof(LEFT, 0), ASSEMBLY.dof(LEFT, 1), ASSEMBLY.dof(RIGHT, 1)]]
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)
    push = np.zeros(len(ASSEMBLY.load))
    for node, share in ASSEMBLY.beam_shares(everywhere=True):
        push[ASSEMBLY.dof(node, 0)] = 40e3 * share
    opensees_wall.loaded(ops, ASSEMBLY, push, steps=20)
    for step in range(1, 21):
        for _ in range(30):
            forces = wall.forces(u, memory)
            u = u + np.linalg.solve(forces.tangent, ASSEMBLY.load + push * step / 20 - forces.internal)
    assert u[ASSEMBLY.dof(LEFT, 0)] == pytest.approx(ops.nodeDisp(LEFT + 1, 1), rel=1e-6)
    assert u[ASSEMBLY.dof(LEFT, 0)] > 0.05  # far beyond the elastic drift


@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_shaken(mass):
    record = si.GroundMotion.synthetic(seed=3).lowpass(20.0).trim(4.0, 6.0).scale_to_pga(6.0)
    base = np.interp(1e-3 * np.arange(1501), record.time, record.values)
    a_0, a_1 = 0.42, 9.8e-4
    opensees_wall.build(ops, ASSEMBLY, JOINTS)
    opensees_wall.loaded(ops, ASSEMBLY)
    theirs = opensees_wall.shaken(ops, base, 1e-3, a_0, a_1, LEFT)
    assembly = ASSEMBLY if mass == "lumped" else Assembly(ASSEMBLY.mesh, ASSEMBLY.masonry)
    wall = DenseWall(assembly, JOINTS, LAW)
    initial = wall.forces(np.zeros(len(ASSEMBLY.load)), wall.nothing).tangent
    history = simulate(wall, base, 1e-3, damping=a_0 * assembly.mass + a_1 * initial)
    ours = history.u[:, ASSEMBLY.dof(LEFT, 0)]
    assert np.abs(ours).max() > 0.02
    apart = np.abs(ours - theirs).max() / np.abs(theirs).max()
    assert apart < (1e-3 if mass == "lumped" else 1e-2)
