"""The wall's equations of motion solved as they are written: dense matrices, Newton iterations, one run at a time.

The reference of the faster formulations, and what a run falls back on where they do not converge.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import scipy

from structid.errors import ConvergenceError
from structid.fem.assembly import Assembly
from structid.mechanics.cohesive_laws import CohesiveLaw, JointLaw

TOLERANCE = 1e-10
"""‖r‖ over ‖p − M ι a_g‖ of a step that has converged."""
ITERATIONS = 30
"""Newton iterations of a step before it is cut."""
LARGEST_CUT = 64
"""Substeps into which a step is cut at most."""


@dataclass(frozen=True, eq=False)
class Forces:
    """Forces at a displacement, and their derivative.

    Parameters
    ----------
    internal : ndarray, shape (dof,)
        [N].
    tangent : ndarray, shape (dof, dof)
        [N/m], not symmetric.
    joints : ndarray, shape (2 joint,)
        Forces of the joints on their jumps [N].
    """

    internal: np.ndarray
    tangent: np.ndarray
    joints: np.ndarray


@dataclass(frozen=True, eq=False)
class DenseWall:
    """A wall with the law of its joints.

    Parameters
    ----------
    assembly : Assembly
        Matrices.
    joint_law : JointLaw
        What its joints obey.
    law : CohesiveLaw
        With which parameters.
    """

    assembly: Assembly
    joint_law: JointLaw
    law: CohesiveLaw

    @property
    def nothing(self) -> np.ndarray:
        """What joints remember that have not been loaded, shape (memory, joint)."""
        return np.zeros((self.joint_law.memories, len(self.assembly.joint_areas)))

    def remembered(self, u: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """What the joints remember of a displacement.

        Parameters
        ----------
        u : ndarray, shape (dof,)
            At the end of a step [m].
        memory : ndarray, shape (memory, joint)
            Before it.

        Returns
        -------
        ndarray, shape (memory, joint)
            After it.
        """
        delta = self.assembly.jumps @ u
        return np.asarray(self.joint_law.remembered(self.law, memory, delta[0::2], delta[1::2]))

    def forces(self, u: np.ndarray, memory: np.ndarray) -> Forces:
        """Internal forces of blocks, bars and joints.

        Parameters
        ----------
        u : ndarray, shape (dof,)
            Displacements [m].
        memory : ndarray, shape (memory, joint)
            What the joints remember.

        Returns
        -------
        Forces
            And the tangent.
        """
        a = self.assembly
        delta, stretch = a.jumps @ u, a.elongations @ u
        response, areas = self.joint_law.respond(self.law, memory, delta[0::2], delta[1::2]), a.joint_areas
        force = np.stack([response.normal * areas, response.tangential * areas], axis=1).reshape(-1)
        tangent = np.zeros((len(delta), len(delta)))
        place = np.arange(0, len(delta), 2)
        tangent[place, place], tangent[place, place + 1] = response.nn * areas, response.nt * areas
        tangent[place + 1, place], tangent[place + 1, place + 1] = response.tn * areas, response.tt * areas
        bars = a.bar_stiffness
        return Forces(
            a.block_stiffness @ u + a.elongations.T @ (bars * stretch) + a.jumps.T @ force,
            a.block_stiffness + a.elongations.T @ (bars[:, None] * a.elongations) + a.jumps.T @ tangent @ a.jumps,
            force,
        )

    def loaded(self) -> tuple[np.ndarray, np.ndarray]:
        """Displacements under the vertical load, which grows in steps, and what the joints remember of it.

        Returns
        -------
        tuple of ndarray, shape (dof,) and (memory, joint)
            [m].

        Raises
        ------
        ConvergenceError
            If there is no equilibrium.
        """
        u, load, memory = np.zeros(len(self.assembly.load)), self.assembly.load, self.nothing
        steps = self.joint_law.load_steps
        for step in range(1, steps + 1):
            wanted = load * step / steps
            for _ in range(ITERATIONS):
                forces = self.forces(u, memory)
                residual = wanted - forces.internal
                if np.linalg.norm(residual) <= TOLERANCE * np.linalg.norm(wanted):
                    break
                u = u + np.linalg.solve(forces.tangent, residual)
            else:
                raise ConvergenceError(f"the vertical load finds no equilibrium at {step / steps:.0%} of it")
            memory = self.remembered(u, memory)
        return u, memory

    def frequencies(self, u: np.ndarray, memory: np.ndarray) -> np.ndarray:
        """Natural frequencies of the tangent's symmetric part.

        Parameters
        ----------
        u : ndarray, shape (dof,)
            Displacements at which the tangent is taken.
        memory : ndarray, shape (memory, joint)
            What the joints remember.

        Returns
        -------
        ndarray, shape (dof,)
            [Hz], from the lowest.
        """
        tangent = self.forces(u, memory).tangent
        squares = scipy.linalg.eigh(0.5 * (tangent + tangent.T), self.assembly.mass, eigvals_only=True)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi))

    def rayleigh(
        self, u: np.ndarray, memory: np.ndarray, ratio: float, modes: tuple[int, int] = (1, 3)
    ) -> tuple[float, float]:
        """Coefficients of C = a₀ M + a₁ K with the damping ratio ζ in two modes: ζ = ½ (a₀/ω + a₁ ω).

        Parameters
        ----------
        u : ndarray, shape (dof,)
            Displacements at which the tangent is taken.
        memory : ndarray, shape (memory, joint)
            What the joints remember.
        ratio : float
            ζ.
        modes : tuple of int
            Numbers of the modes, from 1.

        Returns
        -------
        tuple of float
            a₀ [1/s] and a₁ [s].
        """
        one, other = 2.0 * np.pi * self.frequencies(u, memory)[[modes[0] - 1, modes[1] - 1]]
        return 2.0 * ratio * one * other / (one + other), 2.0 * ratio / (one + other)


@dataclass(frozen=True, eq=False)
class Motion:
    """State of a wall at an instant.

    Parameters
    ----------
    u, v, a : ndarray, shape (dof,)
        Displacement [m], velocity [m/s] and acceleration [m/s²], relative to the base.
    memory : ndarray, shape (memory, joint)
        What the joints remember.
    """

    u: np.ndarray
    v: np.ndarray
    a: np.ndarray
    memory: np.ndarray


@dataclass(frozen=True, eq=False)
class DenseHistory:
    """What becomes of a wall under a record.

    Parameters
    ----------
    u, v : ndarray, shape (time, dof)
        From the loaded wall on.
    joints : ndarray, shape (time, 2 joint)
        Forces of the joints [N].
    base : ndarray, shape (time,)
        Acceleration of the base [m/s²].
    damping : ndarray, shape (dof, dof)
        C.
    converged : bool
        Whether it went to the end.
    """

    u: np.ndarray = field(repr=False)
    v: np.ndarray = field(repr=False)
    joints: np.ndarray = field(repr=False)
    base: np.ndarray = field(repr=False)
    damping: np.ndarray = field(repr=False)
    converged: bool


def simulate(
    wall: DenseWall, base: np.ndarray, dt: float, ratio: float = 0.03, damping: np.ndarray | None = None
) -> DenseHistory:
    """Integrate M u″ + C u′ + f(u) = p − M ι a_g by Newmark's average acceleration with Newton iterations.

    Parameters
    ----------
    wall : DenseWall
        The wall.
    base : ndarray, shape (time,)
        Acceleration of the base at every step [m/s²].
    dt : float
        Step [s].
    ratio : float
        Damping ratio of modes 1 and 3 of the loaded tangent.
    damping : ndarray, shape (dof, dof), optional
        C itself.

    Returns
    -------
    DenseHistory
        As far as it converged.
    """
    a = wall.assembly
    u, memory = wall.loaded()
    if damping is None:
        a_0, a_1 = wall.rayleigh(u, memory, ratio)
        tangent = wall.forces(u, memory).tangent
        damping = a_0 * a.mass + 0.5 * a_1 * (tangent + tangent.T)
    inertia = a.mass @ a.horizontal
    forces = wall.forces(u, memory)
    pushed = np.linalg.solve(a.mass, a.load - inertia * base[0] - forces.internal)
    motion = Motion(u, np.zeros_like(u), pushed, memory)
    kept = [(motion.u, motion.v, forces.joints)]
    for before, after in pairwise(base):
        found = _step(wall, damping, inertia, motion, before, after, dt)
        if found is None:
            break
        motion = found
        kept.append((motion.u, motion.v, wall.forces(motion.u, motion.memory).joints))
    us, vs, joints = (np.array(column) for column in zip(*kept, strict=True))
    return DenseHistory(us, vs, joints, base[: len(us)], damping, len(us) == len(base))


def _step(
    wall: DenseWall, damping: np.ndarray, inertia: np.ndarray, motion: Motion, before: float, after: float, dt: float
) -> Motion | None:
    """One step; cut into 2, 4, … parts where it does not converge, None where that does not help."""
    cut = 1
    while cut <= LARGEST_CUT:
        found: Motion | None = motion
        for part in range(1, cut + 1):
            if found is not None:
                load = wall.assembly.load - inertia * (before + (after - before) * part / cut)
                found = _newton(wall, damping, load, found, dt / cut)
        if found is not None:
            return found
        cut *= 2
    return None


def _newton(wall: DenseWall, damping: np.ndarray, load: np.ndarray, start: Motion, dt: float) -> Motion | None:
    """Average acceleration: u′ = 2/Δt (u − u₀) − u₀′ and u″ = 4/Δt² (u − u₀) − 4/Δt u₀′ − u₀″."""
    mass, limit = wall.assembly.mass, TOLERANCE * np.linalg.norm(load)
    at = replace(start, v=-start.v, a=-4.0 / dt * start.v - start.a)  # where u has not moved yet
    for _ in range(ITERATIONS):
        forces = wall.forces(at.u, start.memory)
        residual = load - mass @ at.a - damping @ at.v - forces.internal
        size = np.linalg.norm(residual)
        if size <= limit:
            return replace(at, memory=wall.remembered(at.u, start.memory))
        if not np.isfinite(size):
            return None
        move = np.linalg.solve(4.0 / dt**2 * mass + 2.0 / dt * damping + forces.tangent, residual)
        at = Motion(at.u + move, at.v + 2.0 / dt * move, at.a + 4.0 / dt**2 * move, start.memory)
    return None
