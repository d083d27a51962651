"""The wall's equations of motion condensed to the jumps of its joints, for many runs at once, inside JAX.

Blocks are linear, and nothing but joints and short bars connects them. In each block's own mass-orthonormal modes q the linear
part is diagonal for any law of the joints. With average acceleration, u′ = 2/Δt (u − u₀) − u₀′ and
u″ = 4/Δt² (u − u₀) − 4/Δt u₀′ − u₀″, a step is

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

import numpy as np
import scipy
from jax import lax

from structid.device import jnp
from structid.fem.assembly import Assembly
from structid.mechanics.cohesive_laws import JointResponse
from structid.mechanics.lanes.block_sparse import BlockPattern, SparseMatrix

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
    tangent : array, shape (pair, 2, 2, run)
        D₀, the symmetric part of the tangent of joints and short bars [N/m].
    """

    q: Any
    a_0: Any
    a_1: Any
    tangent: Any


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
        stiffness = a.block_stiffness + a.elongations[inside].T @ (
            a.bar_stiffness[inside, None] * a.elongations[inside]
        )
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
        """V, shape (jump, mode): opening and slip of every joint one after the other, then elongations of the short bars.

        These are taken in pairs, as those of a joint are: where their number is odd, a row of zeros comes last.
        """
        a = self.assembly
        rows = np.concatenate([a.jumps, a.elongations[a.short_bars]]) @ self.shapes
        rows = np.concatenate([rows, np.zeros((len(rows) % 2, rows.shape[1]))])
        return np.where(np.abs(rows) > 1e-12 * np.abs(rows).max(), rows, 0.0)

    @cached_property
    def opening(self) -> SparseMatrix:
        """V."""
        return SparseMatrix(self.jump_rows)

    @cached_property
    def pushing(self) -> SparseMatrix:
        """Vᵀ."""
        return SparseMatrix(np.ascontiguousarray(self.jump_rows.T))

    @cached_property
    def pattern(self) -> BlockPattern:
        """Pairs of jumps that have a block in common."""
        touching = np.abs(self.jump_rows).reshape(len(self.jump_rows) // 2, 2, -1).max(axis=1) > 0.0
        return BlockPattern.of((touching.astype(int) @ touching.T.astype(int)) > 0)

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
        """E A / L of the short bars, shape (bar,) [N/m]; zero for a row that fills a pair up."""
        bars = self.assembly.bar_stiffness[self.assembly.short_bars]
        return np.concatenate([bars, np.zeros(len(bars) % 2)])

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.assembly.joint_areas)

    # --- forces -------------------------------------------------------------------------------------------------

    def forces(self, law: JointLaw, jumps: Any) -> tuple[Any, Any]:
        """Forces of joints and short bars, and their tangent.

        Parameters
        ----------
        law : callable
            Of the joints.
        jumps : array, shape (jump, run)
            δ [m].

        Returns
        -------
        tuple of array, shape (jump, run) and (pair, 2, 2, run)
            [N], and the blocks of D on its diagonal [N/m].
        """
        areas, count = self.assembly.joint_areas[:, None], 2 * self.joints
        response = law(jumps[0:count:2], jumps[1:count:2])
        of_joints = jnp.stack([response.normal * areas, response.tangential * areas], axis=1).reshape(count, -1)
        rows = [
            jnp.stack([a * areas, b * areas], axis=1)
            for a, b in ((response.nn, response.nt), (response.tn, response.tt))
        ]
        of_bars = jnp.broadcast_to(self._bar_blocks, (len(self.bars) // 2, 2, 2, jumps.shape[1]))
        tangent = jnp.concatenate([jnp.stack(rows, axis=1), of_bars])
        return jnp.concatenate([of_joints, self.bars[:, None] * jumps[count:]]), tangent

    @property
    def _bar_blocks(self) -> np.ndarray:
        """Blocks of the bars' stiffness, shape (pair, 2, 2, 1)."""
        return (self.bars.reshape(-1, 2, 1) * np.eye(2))[..., None]

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
        q = jnp.zeros((len(self.squares), runs))
        for step in range(1, LOAD_STEPS + 1):
            q = self._in_equilibrium(law, lax.stop_gradient(q), step / LOAD_STEPS)
        # One iteration from where it has converged: it has the exact derivatives of the implicit function.
        q = self._iterated(law, lax.stop_gradient(q), 1.0)
        at_rest = self._stiffness(law, q)
        omega = jnp.sqrt(jnp.linalg.eigvalsh(0.5 * (at_rest + at_rest.transpose(0, 2, 1))))
        one, other = omega[:, modes[0] - 1], omega[:, modes[1] - 1]
        tangent = self.forces(law, self.jump_rows @ q)[1]
        a_0, a_1 = 2.0 * ratio * one * other / (one + other), 2.0 * ratio / (one + other)
        return Loaded(q, a_0, a_1, 0.5 * (tangent + tangent.transpose(0, 2, 1, 3)))

    def frequencies(self, law: JointLaw) -> np.ndarray:
        """Natural frequencies of the loaded wall.

        Parameters
        ----------
        law : callable
            Of the joints, of one run.

        Returns
        -------
        ndarray, shape (dof,)
            [Hz], from the lowest.
        """
        tangent = np.asarray(self._stiffness(law, self.loaded(law, 1, 0.0).q))[0]
        squares = np.linalg.eigvalsh(0.5 * (tangent + tangent.T))
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi))

    def _in_equilibrium(self, law: JointLaw, q: Any, share: float) -> Any:
        """Modal displacements under a share of the vertical load, by Newton iterations."""
        limit = STATIC_TOLERANCE * share * float(np.linalg.norm(self.load))

        def missed(q: Any) -> Any:
            return jnp.linalg.norm(self._out_of_balance(law, q, share), axis=0) > limit

        def iterate(carried: tuple[Any, Any]) -> tuple[Any, Any]:
            q, count = carried
            return jnp.where(missed(q), self._iterated(law, q, share), q), count + 1

        found, _ = lax.while_loop(
            lambda carried: jnp.any(missed(carried[0])) & (carried[1] < ITERATIONS), iterate, (q, 0)
        )
        return found

    def _out_of_balance(self, law: JointLaw, q: Any, share: float) -> Any:
        force, _ = self.forces(law, self.jump_rows @ q)
        return share * self.load[:, None] - self.squares[:, None] * q - self.jump_rows.T @ force

    def _stiffness(self, law: JointLaw, q: Any) -> Any:
        """Λ + Vᵀ D V, shape (run, mode, mode)."""
        rows, tangent = self.jump_rows, self.forces(law, self.jump_rows @ q)[1]
        spread = jnp.einsum("gabr,gbm->rgam", tangent, rows.reshape(-1, 2, rows.shape[1]))
        return jnp.diag(self.squares) + jnp.einsum("jm,rjn->rmn", rows, spread.reshape(-1, *rows.shape))

    def _iterated(self, law: JointLaw, q: Any, share: float) -> Any:
        right = self._out_of_balance(law, q, share).T[:, :, None]
        return q + jnp.linalg.solve(self._stiffness(law, q), right)[:, :, 0].T

    # --- motion -------------------------------------------------------------------------------------------------

    def start(self, loaded: Loaded, base: float) -> WallState:
        """State at rest, with the acceleration that equilibrium with the base's first one asks for.

        Parameters
        ----------
        loaded : Loaded
            The wall under its load.
        base : float
            Acceleration of the base [m/s²].

        Returns
        -------
        WallState
            Before the first step.
        """
        jumps = self.jump_rows @ loaded.q
        still, nothing = jnp.zeros_like(loaded.q), jnp.zeros_like(jumps)
        pushed = jnp.broadcast_to(-self.inertia[:, None] * base, loaded.q.shape)
        return WallState(loaded.q, still, pushed, jumps, jumps, jumps, nothing, jnp.ones(loaded.q.shape[1], dtype=bool))

    def stepping(self, law: JointLaw, loaded: Loaded, dt: float) -> Callable[[WallState, Any], WallState]:
        """Give the step of average acceleration.

        Parameters
        ----------
        law : callable
            Of the joints.
        loaded : Loaded
            The wall under its load, with its damping.
        dt : float
            Step [s].

        Returns
        -------
        callable
            ``step(state, base)``: the state after the step, at whose end the base accelerates by `base`.
        """
        squares, two = self.squares[:, None], 2.0 / dt
        own_damping = loaded.a_0 + loaded.a_1 * squares  # of a block's mode, a₀ + a₁ λ
        weights = 1.0 / (two**2 + two * own_damping + squares)
        compliance = self._compliance(weights)
        dashpots = loaded.a_1 * loaded.tangent

        def step(state: WallState, base: Any) -> WallState:
            pushed = (
                self.load[:, None] - self.inertia[:, None] * base
                + two**2 * state.q + 2.0 * two * state.rate + state.acceleration
                + own_damping * (two * state.q + state.rate)
            )  # fmt: skip
            free = self.opening.times(weights * pushed)
            before = two * state.jumps + state.jump_rate

            def force_and_tangent(jumps: Any) -> tuple[Any, Any]:
                force, tangent = self.forces(law, jumps)
                rate = (two * jumps - before).reshape(-1, 2, jumps.shape[1])
                damped = jnp.einsum("gabr,gbr->gar", dashpots, rate).reshape(jumps.shape)
                return force + damped, tangent + two * dashpots

            def iterate(carried: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
                jumps, going, count = carried
                force, tangent = force_and_tangent(jumps)
                missed = jumps - free + self.pattern.times(compliance, force)
                move = self.pattern.solve_one_plus(compliance, tangent, missed)
                moved = jumps - move
                near = jnp.max(jnp.abs(move), axis=0) <= TOLERANCE * (1.0 + jnp.max(jnp.abs(moved), axis=0))
                return jnp.where(going, moved, jumps), going & ~near, count + 1.0

            guess = 3.0 * (state.jumps - state.before) + state.long_before
            found, going, _ = lax.while_loop(
                lambda carried: jnp.any(carried[1]) & (carried[2] < ITERATIONS),
                iterate,
                (guess, state.converged, 0.0),
            )
            # What has not converged is nobody's response.
            q = jnp.where(going, jnp.nan, weights * (pushed - self.pushing.times(force_and_tangent(found)[0])))
            rate = two * (q - state.q) - state.rate
            return WallState(
                q,
                rate,
                two * (rate - state.rate) - state.acceleration,
                found,
                state.jumps,
                state.before,
                two * found - before,
                state.converged & ~going,
            )

        return step

    def _compliance(self, weights: Any) -> Any:
        """Blocks of F = V W Vᵀ, shape (block, 2, 2, run)."""
        rows, pattern = self.jump_rows.reshape(-1, 2, len(self.squares)), self.pattern
        return jnp.einsum("bim,mr,bjm->bijr", rows[pattern.rows], weights, rows[pattern.columns])
