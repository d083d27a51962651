"""A wall at rest under its vertical load: displacements, natural frequencies, Rayleigh damping."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np
from jax import lax
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.mechanics.cohesive_laws import CohesiveLaw
from structid.models.masonry.equations.condensed import Condensed

ITERATIONS = 25
"""Largest number of Newton iterations of a load step."""
TOLERANCE = 1e-12
"""Largest ratio of ‖r‖ to ‖p‖ for a wall in equilibrium."""


class Loaded(NamedTuple):
    """A wall at rest under its vertical load, with the constants of its motion."""

    q: Float[Array, "mode run"]  # modal displacements
    a_0: Float[Array, " run"]  # Rayleigh's mass coefficient [1/s]
    a_1: Float[Array, " run"]  # Rayleigh's stiffness coefficient [s]
    memory: Float[Array, "memory joint run"]  # memory of the joints
    tangent: Float[Array, "pair 2 2 run"]  # D₀, the symmetric part of the tangent of joints and short bars [N/m]


def loaded(wall: Condensed, law: CohesiveLaw, runs: int, ratio: float, modes: tuple[int, int] = (1, 3)) -> Loaded:
    """Load the wall, and determine the Rayleigh damping of the loaded wall: ζ = ½ (a₀/ω + a₁ ω) in two modes."""
    q, memory = jnp.zeros((len(wall.squares), runs)), jnp.zeros((wall.joint_law.memories, wall.joints, runs))
    held = jax.tree.map(lax.stop_gradient, law)
    steps = wall.joint_law.load_steps
    for step in range(1, steps + 1):
        q = _in_equilibrium(wall, held, memory, q, step / steps)
        memory = wall.remembered(held, memory, wall.jump_rows @ q) if step < steps else memory
    # One more iteration from the converged state gives the exact derivatives of the implicit function.
    q = _iterated(wall, law, memory, lax.stop_gradient(q), 1.0)
    memory = wall.remembered(law, memory, wall.jump_rows @ q)
    at_rest = _stiffness(wall, law, memory, q)
    omega = jnp.sqrt(jnp.linalg.eigvalsh(0.5 * (at_rest + at_rest.transpose(0, 2, 1))))
    one, other = omega[:, modes[0] - 1], omega[:, modes[1] - 1]
    tangent = wall.forces(law, memory, wall.jump_rows @ q)[1]
    a_0, a_1 = 2.0 * ratio * one * other / (one + other), 2.0 * ratio / (one + other)
    return Loaded(q, a_0, a_1, memory, 0.5 * (tangent + tangent.transpose(0, 2, 1, 3)))


def frequencies(wall: Condensed, law: CohesiveLaw) -> Float[np.ndarray, " dof"]:
    """Compute the natural frequencies of the loaded wall."""
    at_rest = loaded(wall, law, 1, 0.0)
    tangent = np.asarray(_stiffness(wall, law, at_rest.memory, at_rest.q))[0]
    squares = np.linalg.eigvalsh(0.5 * (tangent + tangent.T))
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi))


def _in_equilibrium(wall: Condensed, law: CohesiveLaw, memory: Any, q: Any, share: float) -> Any:
    """Compute the modal displacements under a fraction of the vertical load by Newton iterations."""
    limit = TOLERANCE * share * float(np.linalg.norm(wall.load))

    def missed(q: Any) -> Any:
        return jnp.linalg.norm(_out_of_balance(wall, law, memory, q, share), axis=0) > limit

    def iterate(carried: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        q, going, count = carried
        iterated = jnp.where(going, _iterated(wall, law, memory, q, share), q)
        return iterated, missed(iterated), count + 1

    # The loop carries the mask of unfinished runs instead of computing it in its condition. Mapped over runs, JAX evaluates a
    # condition twice. Different rounding of a residual at its limit could then make the loop endless.
    result, _, _ = lax.while_loop(
        lambda carried: jnp.any(carried[1]) & (carried[2] < ITERATIONS), iterate, (q, missed(q), 0)
    )
    return result


def _out_of_balance(wall: Condensed, law: CohesiveLaw, memory: Any, q: Any, share: float) -> Any:
    force, _ = wall.forces(law, memory, wall.jump_rows @ q)
    return share * wall.load[:, None] - wall.squares[:, None] * q - wall.jump_rows.T @ force


def _stiffness(wall: Condensed, law: CohesiveLaw, memory: Any, q: Any) -> Any:
    """Compute Λ + Vᵀ D V, shape (run, mode, mode)."""
    rows, tangent = wall.jump_rows, wall.forces(law, memory, wall.jump_rows @ q)[1]
    spread = jnp.einsum("gabr,gbm->rgam", tangent, rows.reshape(-1, 2, rows.shape[1]))
    return jnp.diag(wall.squares) + jnp.einsum("jm,rjn->rmn", rows, spread.reshape(-1, *rows.shape))


def _iterated(wall: Condensed, law: CohesiveLaw, memory: Any, q: Any, share: float) -> Any:
    right = _out_of_balance(wall, law, memory, q, share).T[:, :, None]
    return q + jnp.linalg.solve(_stiffness(wall, law, memory, q), right)[:, :, 0].T
