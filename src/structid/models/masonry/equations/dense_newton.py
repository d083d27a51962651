"""Equations of motion of a wall with dense matrices and Newton iterations, one run at a time.

This formulation is the reference for the faster formulations, and the fallback if they do not converge.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import ConvergenceError
from structid.mechanics.cohesive_laws import CohesiveLaw, JointLaw
from structid.models.masonry.finite_elements.assembly import Assembly

TOLERANCE = 1e-10
"""Largest ratio of ‖r‖ to ‖p − M ι a_g‖ in a converged step."""
ITERATIONS = 30
"""Number of Newton iterations without convergence after which a step is divided."""
LARGEST_CUT = 64
"""Largest number of substeps into which a step is divided."""


@dataclass(frozen=True, eq=False)
class Forces:
    """Forces at a displacement, and their derivative."""

    internal: Float[np.ndarray, " dof"]  # [N]
    tangent: Any  # [N/m], not symmetric
    joints: Float[np.ndarray, " _"]  # joint forces conjugate to the jumps [N]


class WallMatrices(NamedTuple):
    """Matrices of a wall: mass, block stiffness, jumps, elongations, and the total stiffness of blocks and bars."""

    mass: Any
    blocks: Any
    jumps: Any
    elongations: Any
    linear: Any


@dataclass(frozen=True, eq=False)
class DenseWall:
    """A wall with the constitutive law of its joints."""

    assembly: Assembly  # Matrices
    joint_law: JointLaw  # constitutive law of the joints
    law: CohesiveLaw  # parameters of the joint law

    @property
    def nothing(self) -> np.ndarray:
        """Memory of unloaded joints, shape (memory, joint)."""
        return np.zeros((self.joint_law.memories, len(self.assembly.joint_areas)))

    def remembered(
        self, u: Float[np.ndarray, " dof"], memory: Float[np.ndarray, "memory joint"]
    ) -> Float[np.ndarray, "memory joint"]:
        """Return the memory of the joints after the wall is displaced to `u`."""
        delta = self.matrices.jumps @ u
        return np.asarray(self.joint_law.remembered(self.law, memory, delta[0::2], delta[1::2]))

    def forces(self, u: Float[np.ndarray, " dof"], memory: Float[np.ndarray, "memory joint"]) -> Forces:
        """Compute the internal forces of blocks, bars and joints."""
        m, areas, bars = self.matrices, self.assembly.joint_areas, self.assembly.bar_stiffness
        delta = m.jumps @ u
        response = self.joint_law.respond(self.law, memory, delta[0::2], delta[1::2])
        force = np.stack([response.normal * areas, response.tangential * areas], axis=1).reshape(-1)
        blocks = np.array([[response.nn * areas, response.nt * areas], [response.tn * areas, response.tt * areas]])
        return Forces(
            m.blocks @ u + m.elongations.T @ (bars * (m.elongations @ u)) + m.jumps.T @ force,
            m.linear + m.jumps.T @ self.block_diagonal(blocks.transpose(2, 0, 1)) @ m.jumps,
            force,
        )

    @cached_property
    def matrices(self) -> WallMatrices:
        """Matrices of the assembly in this formulation."""
        a = self.assembly
        linear = a.block_stiffness + a.elongations.T @ (a.bar_stiffness[:, None] * a.elongations)
        return WallMatrices(a.mass, a.block_stiffness, a.jumps, a.elongations, linear)

    def block_diagonal(self, blocks: Float[np.ndarray, "joint 2 2"]) -> Float[Array, "_ _"]:
        """Assemble a block-diagonal matrix."""
        matrix = np.zeros((len(blocks), 2, len(blocks), 2))
        index = np.arange(len(blocks))
        matrix[index, :, index, :] = blocks
        return matrix.reshape(2 * len(blocks), -1)

    def solved(self, matrix: Any, right: Float[np.ndarray, " dof"]) -> Float[np.ndarray, " dof"]:
        """Solve a linear system."""
        return np.linalg.solve(matrix, right)

    def loaded(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute the displacements under the vertical load, applied in steps, and the memory of the joints."""
        u, load, memory = np.zeros(len(self.assembly.load)), self.assembly.load, self.nothing
        steps = self.joint_law.load_steps
        for step in range(1, steps + 1):
            target_load = load * step / steps
            for _ in range(ITERATIONS):
                forces = self.forces(u, memory)
                residual = target_load - forces.internal
                if np.linalg.norm(residual) <= TOLERANCE * np.linalg.norm(target_load):
                    break
                u = u + self.solved(forces.tangent, residual)
            else:
                raise ConvergenceError(f"no equilibrium was found at {step / steps:.0%} of the vertical load")
            memory = self.remembered(u, memory)
        return u, memory

    def frequencies(
        self, u: Float[np.ndarray, " dof"], memory: Float[np.ndarray, "memory joint"]
    ) -> Float[np.ndarray, " mode"]:
        """Compute the natural frequencies of the symmetric part of the tangent."""
        tangent = self.forces(u, memory).tangent
        squares = self.lowest(0.5 * (tangent + tangent.T))
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi))

    def lowest(self, stiffness: Any) -> np.ndarray:
        """Compute the lowest squared natural frequencies."""
        return np.asarray(scipy.linalg.eigh(stiffness, self.matrices.mass, eigvals_only=True))

    def rayleigh(
        self,
        u: Float[np.ndarray, " dof"],
        memory: Float[np.ndarray, "memory joint"],
        ratio: float,
        modes: tuple[int, int] = (1, 3),
    ) -> tuple[float, float]:
        """Compute the coefficients of C = a₀ M + a₁ K with the damping ratio ζ in two modes: ζ = ½ (a₀/ω + a₁ ω)."""
        one, other = 2.0 * np.pi * self.frequencies(u, memory)[[modes[0] - 1, modes[1] - 1]]
        return 2.0 * ratio * one * other / (one + other), 2.0 * ratio / (one + other)


@dataclass(frozen=True, eq=False)
class WallMotion:
    """State of motion of a wall at an instant, relative to the base."""

    u: Float[np.ndarray, " dof"]  # displacement [m]
    v: Float[np.ndarray, " dof"]  # velocity [m/s]
    a: Float[np.ndarray, " dof"]  # acceleration [m/s²]
    memory: Float[np.ndarray, "memory joint"]  # memory of the joints


@dataclass(frozen=True, eq=False)
class DenseHistory:
    """Response of a wall to a record."""

    u: Float[np.ndarray, "time dof"] = field(repr=False)  # displacements, starting at the loaded wall
    v: Float[np.ndarray, "time dof"] = field(repr=False)  # velocities
    a: Float[np.ndarray, "time dof"] = field(repr=False)  # accelerations
    memory: Float[np.ndarray, "time memory joint"] = field(repr=False)  # memory of the joints
    joints: Float[np.ndarray, "time _"] = field(repr=False)  # forces of the joints [N]
    base: Float[np.ndarray, " time"] = field(repr=False)  # acceleration of the base [m/s²]
    damping: Any = field(repr=False)  # C
    converged: bool  # whether the run reached the end


def simulate(
    wall: DenseWall, base: Float[np.ndarray, " time"], dt: float, ratio: float = 0.03, damping: Any | None = None
) -> DenseHistory:
    """Integrate M u″ + C u′ + f(u) = p − M ι a_g by Newmark's average acceleration with Newton iterations."""
    a = wall.assembly
    u, memory = wall.loaded()
    if damping is None:
        a_0, a_1 = wall.rayleigh(u, memory, ratio)
        tangent = wall.forces(u, memory).tangent
        damping = a_0 * wall.matrices.mass + 0.5 * a_1 * (tangent + tangent.T)
    mass = wall.matrices.mass
    inertia = mass @ a.horizontal
    forces = wall.forces(u, memory)
    pushed = wall.solved(mass, a.load - inertia * base[0] - forces.internal)
    motion = WallMotion(u, np.zeros_like(u), pushed, memory)
    kept = [(motion.u, motion.v, motion.a, motion.memory, forces.joints)]
    for before, after in pairwise(base):
        next_motion = _step(wall, damping, inertia, motion, before, after, dt)
        if next_motion is None:
            break
        motion = next_motion
        kept.append((motion.u, motion.v, motion.a, motion.memory, wall.forces(motion.u, motion.memory).joints))
    us, vs, accelerations, memories, joints = (np.array(column) for column in zip(*kept, strict=True))
    return DenseHistory(us, vs, accelerations, memories, joints, base[: len(us)], damping, len(us) == len(base))


def _step(
    wall: DenseWall, damping: Any, inertia: np.ndarray, motion: WallMotion, before: float, after: float, dt: float
) -> WallMotion | None:
    """Take one step, divided into 2, 4, … parts if it does not converge; return None if no division converges."""
    cut = 1
    while cut <= LARGEST_CUT:
        next_motion: WallMotion | None = motion
        for part in range(1, cut + 1):
            if next_motion is not None:
                load = wall.assembly.load - inertia * (before + (after - before) * part / cut)
                next_motion = _newton(wall, damping, load, next_motion, dt / cut)
        if next_motion is not None:
            return next_motion
        cut *= 2
    return None


def _newton(wall: DenseWall, damping: Any, load: np.ndarray, start: WallMotion, dt: float) -> WallMotion | None:
    """Solve a step of average acceleration: u′ = 2/Δt (u − u₀) − u₀′ and u″ = 4/Δt² (u − u₀) − 4/Δt u₀′ − u₀″."""
    mass, limit = wall.matrices.mass, TOLERANCE * np.linalg.norm(load)
    at = replace(start, v=-start.v, a=-4.0 / dt * start.v - start.a)  # values at u = u₀
    for _ in range(ITERATIONS):
        forces = wall.forces(at.u, start.memory)
        residual = load - mass @ at.a - damping @ at.v - forces.internal
        size = np.linalg.norm(residual)
        if size <= limit:
            return replace(at, memory=wall.remembered(at.u, start.memory))
        if not np.isfinite(size):
            return None
        move = wall.solved(4.0 / dt**2 * mass + 2.0 / dt * damping + forces.tangent, residual)
        at = WallMotion(at.u + move, at.v + 2.0 / dt * move, at.a + 4.0 / dt**2 * move, start.memory)
    return None
