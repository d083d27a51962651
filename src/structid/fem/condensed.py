"""The wall's equations of motion condensed to the jumps of its joints, for many runs at once, inside JAX.

Blocks are linear, and nothing but joints and short bars connects them. In each block's own mass-orthonormal modes q the linear part is
diagonal for any law of the joints. With average acceleration, u′ = 2/Δt (u − u₀) − u₀′ and u″ = 4/Δt² (u − u₀) − 4/Δt u₀′ − u₀″, the
step is

    q = W (b − Vᵀ g(δ)),    W = 1 / (4/Δt² + 2 a₀/Δt + (1 + 2 a₁/Δt) λ),    δ = V q,
    b = p − ι a_g + 4/Δt² q₀ + 4/Δt q₀′ + q₀″ + (a₀ + a₁ λ)(2/Δt q₀ + q₀′),
    g(δ) = f(δ) + a₁ D₀ δ′,    δ′ = 2/Δt (δ − δ₀) − δ₀′,

with the forces f of joints and short bars, and their symmetric tangent D₀ at the loaded wall. So the jumps alone are unknown:
δ = V W b − F g(δ), F = V W Vᵀ. Newton's matrix is I + F (D + 2 a₁/Δt D₀).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np
import scipy
from jax import lax

from structid.device import jnp
from structid.fem.assembly import Assembly
from structid.mechanics.cohesive_laws import JointResponse

JointLaw = Callable[[Any, Any], JointResponse]
"""Tractions and tangents of all joints, (joint, run), from their openings and slips."""

LOAD_STEPS = 4
"""Of the static ramp."""
ITERATIONS = 25
"""Newton iterations of a step at most."""
STATIC_TOLERANCE = 1e-12
"""‖r‖ over ‖p‖ of the loaded wall."""
TOLERANCE = 1e-13
"""Change of a jump [m] over one metre and the largest jump, at which iterations end."""


class Loaded(NamedTuple):
    """A wall at rest under its vertical load, and what its motion needs.

    Parameters
    ----------
    q : array, shape (mode, run)
        Modal displacements.
    a_0, a_1 : array, shape (run,)
        Rayleigh's coefficients [1/s] and [s].
    damping : array, shape (3, joint, run)
        Symmetric tangent of the joints' forces: nn, nt, tt [N/m].
    """

    q: Any
    a_0: Any
    a_1: Any
    damping: Any


class WallState(NamedTuple):
    """State of a wall between two steps; shapes (mode, run) and (jump, run).

    Parameters
    ----------
    q, rate, acceleration : array
        Modal displacements and their derivatives.
    jumps, before, long_before : array
        Jumps now and at the two steps before, from which the next are guessed.
    jump_rate : array
        δ′.
    converged : array of bool, shape (run,)
        Whether every step has converged.
    """

    q: Any
    rate: Any
    acceleration: Any
    jumps: Any
    before: Any
    long_before: Any
    jump_rate: Any
    converged: Any


@dataclass(frozen=True, eq=False)
class Condensed:
    """Constants of the condensed equations.

    Parameters
    ----------
    assembly : Assembly
        Matrices of the wall.
    """

    assembly: Assembly = field(repr=False)

    @cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Φ, shape (dof, mode), and λ: mass-orthonormal modes of every block with the bars within it."""
        a = self.assembly
        inside = ~a.short_bars
        stiffness = a.block_stiffness + a.elongations[inside].T @ (a.bar_stiffness[inside, None] * a.elongations[inside])
        block_of_dof = a.mesh.free // 8
        shapes, squares = np.zeros_like(stiffness), np.zeros(len(stiffness))
        for block in range(len(a.mesh.blocks)):
            own = np.flatnonzero(block_of_dof == block)
            here = np.ix_(own, own)
            values, vectors = scipy.linalg.eigh(stiffness[here], a.mass[here])
            # Rigid motions have none, up to rounding.
            squares[own], shapes[here] = np.where(values > 1e-9 * values.max(), values, 0.0), vectors
        return shapes, squares

    @property
    def shapes(self) -> np.ndarray:
        """Φ, shape (dof, mode): u = Φ q."""
        return self._modes[0]

    @property
    def squares(self) -> np.ndarray:
        """λ, shape (mode,) [1/s²]."""
        return self._modes[1]

    @cached_property
    def jump_rows(self) -> np.ndarray:
        """V, shape (jump, mode): openings and slips of the joints one after the other, then elongations of the short bars."""
        a = self.assembly
        rows = np.concatenate([a.jumps, a.elongations[a.short_bars]]) @ self.shapes
        return np.where(np.abs(rows) > 1e-12 * np.abs(rows).max(), rows, 0.0)

    @cached_property
    def load(self) -> np.ndarray:
        """Φᵀ p, shape (mode,)."""
        return np.asarray(self.shapes.T @ self.assembly.load)

    @cached_property
    def inertia(self) -> np.ndarray:
        """Φᵀ M ι, shape (mode,)."""
        return np.asarray(self.shapes.T @ self.assembly.mass @ self.assembly.horizontal)

    @cached_property
    def bars(self) -> np.ndarray:
        """E A / L of the short bars, shape (bar,) [N/m]."""
        return np.asarray(self.assembly.bar_stiffness[self.assembly.short_bars])

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.assembly.joint_areas)

    # --- forces -------------------------------------------------------------------------------------------------

    def forces(self, law: JointLaw, jumps: Any) -> tuple[Any, Any]:
        """Forces of joints and short bars, and the tangent of the joints.

        Parameters
        ----------
        law : callable
            Of the joints.
        jumps : array, shape (jump, run)
            δ [m].

        Returns
        -------
        tuple of array, shape (jump, run) and (4, joint, run)
            [N], and nn, nt, tn, tt [N/m].
        """
        areas, count = self.assembly.joint_areas[:, None], 2 * self.joints
        response = law(jumps[0:count:2], jumps[1:count:2])
        of_joints = jnp.stack([response.normal * areas, response.tangential * areas], axis=1).reshape(count, -1)
        tangent = jnp.stack([response.nn * areas, response.nt * areas, response.tn * areas, response.tt * areas])
        return jnp.concatenate([of_joints, self.bars[:, None] * jumps[count:]]), tangent

    def times_tangent(self, columns: Any, tangent: Any, bars: Any) -> Any:
        """C D of a matrix over the jumps and the block-diagonal tangent of joints and short bars.

        Parameters
        ----------
        columns : array, shape (row, jump)
            C.
        tangent : array, shape (4, joint)
            nn, nt, tn, tt.
        bars : array, shape (bar,)
            Of the short bars.

        Returns
        -------
        array, shape (row, jump)
            The product.
        """
        count = 2 * self.joints
        n, t = columns[:, 0:count:2], columns[:, 1:count:2]
        nn, nt, tn, tt = tangent
        pairs = jnp.stack([n * nn + t * tn, n * nt + t * tt], axis=2).reshape(columns.shape[0], count)
        return jnp.concatenate([pairs, columns[:, count:] * bars], axis=1)

    # --- the loaded wall ----------------------------------------------------------------------------------------

    def loaded(self, law: JointLaw, runs: int, ratio: float, modes: tuple[int, int] = (1, 3)) -> Loaded:
        """Load the wall, and find its Rayleigh damping there: ζ = ½ (a₀/ω + a₁ ω) in two modes.

        Parameters
        ----------
        law : callable
            Of the joints.
        runs : int
            Number of runs.
        ratio : float
            ζ.
        modes : tuple of int
            Numbers of the modes, from 1.

        Returns
        -------
        Loaded
            Of every run.
        """
        rows = self.jump_rows

        def residual(q: Any, share: float) -> Any:
            force, _ = self.forces(law, rows @ q)
            return share * self.load[:, None] - self.squares[:, None] * q - rows.T @ force

        def stiffness(q: Any) -> Any:
            tangent = self.forces(law, rows @ q)[1]
            return jax.vmap(
                lambda own: jnp.diag(self.squares) + self.times_tangent(rows.T, own, self.bars) @ rows, in_axes=2
            )(tangent)

        def move(q: Any, share: float) -> Any:
            return q + jnp.linalg.solve(stiffness(q), residual(q, share).T[:, :, None])[:, :, 0].T

        q = jnp.zeros((len(self.squares), runs))
        for step in range(1, LOAD_STEPS + 1):
            share = step / LOAD_STEPS
            limit = STATIC_TOLERANCE * share * np.linalg.norm(self.load)

            def missed(q: Any, share: float = share) -> Any:
                return jnp.linalg.norm(residual(q, share), axis=0)

            def go_on(carried: tuple[Any, Any], limit: float = limit, missed: Callable[..., Any] = missed) -> Any:
                return (carried[1] < ITERATIONS) & jnp.any(missed(carried[0]) > limit)

            def iterate(
                carried: tuple[Any, Any], share: float = share, limit: float = limit, missed: Callable[..., Any] = missed
            ) -> tuple[Any, Any]:
                q, count = carried
                return jnp.where(missed(q) > limit, move(q, share), q), count + 1

            q, _ = lax.while_loop(go_on, iterate, (lax.stop_gradient(q), 0))
        # One iteration from where it has converged: it has the exact derivatives of the implicit function.
        q = move(lax.stop_gradient(q), 1.0)
        at_rest = stiffness(q)
        omega = jnp.sqrt(jnp.linalg.eigvalsh(0.5 * (at_rest + at_rest.transpose(0, 2, 1))))
        one, other = omega[:, modes[0] - 1], omega[:, modes[1] - 1]
        nn, nt, tn, tt = self.forces(law, rows @ q)[1]
        a_0, a_1 = 2.0 * ratio * one * other / (one + other), 2.0 * ratio / (one + other)
        return Loaded(q, a_0, a_1, jnp.stack([nn, 0.5 * (nt + tn), tt]))
