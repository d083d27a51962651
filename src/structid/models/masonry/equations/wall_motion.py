"""Motion of a wall: average acceleration with Newton iterations on the jumps of its joints; see `condensed`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax
from jaxtyping import Bool, Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.mechanics.cohesive_laws import CohesiveLaw
from structid.models.masonry.equations.condensed import Condensed
from structid.models.masonry.equations.loaded_wall import Loaded

ITERATIONS = 25
"""Largest number of Newton iterations of a step."""
TOLERANCE = 1e-13
"""Convergence limit for the change of a jump [m], relative to one metre and to the largest jump."""


class WallState(NamedTuple):
    """State of a wall between two steps; modal arrays have shape (mode, run), jumps have shape (jump, run)."""

    q: Any  # modal displacements
    rate: Any  # modal velocities
    acceleration: Any  # modal accelerations
    jumps: Any  # jumps; the first guess uses them and the jumps of the two previous steps
    before: Any  # jumps of the previous step
    long_before: Any  # jumps two steps before
    jump_rate: Any  # δ′
    memory: Float[Array, "memory joint run"]  # memory of the joints
    converged: Bool[Array, " run"]  # Whether every step has converged


class Fixed(NamedTuple):
    """Constants that are equal in all steps."""

    law: CohesiveLaw  # parameters of the joints
    compliance: Any  # blocks of F
    dashpots: Float[Array, "pair 2 2 run"]  # a₁ D₀ [N s/m]


class Unknown(NamedTuple):
    """Data on which the jumps of a step depend."""

    fixed: Fixed  # constants of all steps
    memory: Float[Array, "memory joint run"]  # memory of the joints
    free: Float[Array, "jump run"]  # δ_free = V W b, the jumps without joint forces
    before: Float[Array, "jump run"]  # 2/Δt δ₀ + δ₀′


def start(wall: Condensed, loaded: Loaded, base: float) -> WallState:
    """Return the state of the wall at rest, with its acceleration under the first acceleration of the base."""
    jumps = wall.jump_rows @ loaded.q
    still, nothing = jnp.zeros_like(loaded.q), jnp.zeros_like(jumps)
    pushed = jnp.broadcast_to(-wall.inertia[:, None] * base, loaded.q.shape)
    converged = jnp.ones(loaded.q.shape[1], dtype=bool)
    return WallState(loaded.q, still, pushed, jumps, jumps, jumps, nothing, loaded.memory, converged)


def stepping(wall: Condensed, law: CohesiveLaw, loaded: Loaded, dt: float) -> Callable[[WallState, Any], WallState]:
    """Return the function that takes one step of the average acceleration method."""
    squares, two = wall.squares[:, None], 2.0 / dt
    own_damping = loaded.a_0 + loaded.a_1 * squares  # damping of a block mode, a₀ + a₁ λ
    weights = 1.0 / (two**2 + two * own_damping + squares)
    fixed = Fixed(law, wall.compliance(weights), loaded.a_1 * loaded.tangent)
    solved = jump_solver(wall, two)

    def step(state: WallState, base: Any) -> WallState:
        pushed = (
            wall.load[:, None]
            - wall.inertia[:, None] * base
            + two**2 * state.q
            + 2.0 * two * state.rate
            + state.acceleration
            + own_damping * (two * state.q + state.rate)
        )
        before = two * state.jumps + state.jump_rate
        unknown = Unknown(fixed, state.memory, wall.opening.times(weights * pushed), before)
        guess = 3.0 * (state.jumps - state.before) + state.long_before
        jumps, force, going = solved(unknown, lax.stop_gradient(guess), state.converged)
        # A step that has not converged gives no response.
        q = jnp.where(going, jnp.nan, weights * (pushed - wall.pushing.times(force)))
        rate = two * (q - state.q) - state.rate
        return WallState(
            q,
            rate,
            two * (rate - state.rate) - state.acceleration,
            jumps,
            state.jumps,
            state.before,
            two * jumps - before,
            wall.remembered(law, state.memory, jumps),
            state.converged & ~going,
        )

    return step


def jump_solver(wall: Condensed, two: float) -> Callable[[Unknown, Any, Any], tuple[Any, Any, Any]]:
    """Return a function that solves δ = δ_free − F g(δ); it returns δ, g and a mask of the runs without convergence.

    Derivatives follow from the implicit function theorem: with R = δ − δ_free + F g, δ̇ = −(I + F G)⁻¹ Ṙ at fixed δ.
    """

    def forces(unknown: Unknown, jumps: Any) -> tuple[Any, Any]:
        """Return the forces g including dashpot forces, and their tangent G."""
        fixed = unknown.fixed
        force, tangent = wall.forces(fixed.law, unknown.memory, jumps)
        rate = (two * jumps - unknown.before).reshape(-1, 2, jumps.shape[1])
        damped = jnp.einsum("gabr,gbr->gar", fixed.dashpots, rate).reshape(jumps.shape)
        return force + damped, tangent + two * fixed.dashpots

    def missed(unknown: Unknown, jumps: Any) -> Any:
        return jumps - unknown.free + wall.pattern.times(unknown.fixed.compliance, forces(unknown, jumps)[0])

    def moved(unknown: Unknown, jumps: Any, right: Any) -> Any:
        return wall.pattern.solve_one_plus(unknown.fixed.compliance, forces(unknown, jumps)[1], right)

    def iterated(unknown: Unknown, guess: Any, converged: Any) -> tuple[Any, Any]:
        def iterate(carried: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
            jumps, going, count = carried
            move = moved(unknown, jumps, missed(unknown, jumps))
            near = jnp.max(jnp.abs(move), axis=0) <= TOLERANCE * (1.0 + jnp.max(jnp.abs(jumps), axis=0))
            return jnp.where(going, jumps - move, jumps), going & ~near, count + 1.0

        jumps, going, _ = lax.while_loop(
            lambda carried: jnp.any(carried[1]) & (carried[2] < ITERATIONS), iterate, (guess, converged, 0.0)
        )
        return jumps, going

    implicit = jax.custom_jvp(iterated)

    def with_slope(primals: Any, tangents: Any) -> Any:
        unknown = primals[0]
        jumps, going = implicit(*primals)
        _, slope = jax.jvp(lambda u: missed(u, jumps), (unknown,), (tangents[0],))
        return (jumps, going), (-moved(unknown, jumps, slope), np.zeros(going.shape, dtype=jax.dtypes.float0))

    implicit.defjvp(with_slope)

    def solved(unknown: Unknown, guess: Any, converged: Any) -> tuple[Any, Any, Any]:
        jumps, going = implicit(unknown, guess, converged)
        return jumps, forces(unknown, jumps)[0], going

    return solved
