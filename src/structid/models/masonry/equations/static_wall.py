"""A wall under a rigid beam that is moved slowly: its forces against the beam, without inertia.

The blocks under the beam move with it. In the modes q of the blocks with the beam at rest, and with the jumps J d that the beam's
motion d alone would open, equilibrium is

    Λ q + Vᵀ f(δ) = 0,    δ = V q + J d,    forces on the beam  r = Jᵀ f(δ).

Blocks that only joints hold have modes with λ = 0. So q is found by proximal steps: Λ q + Vᵀ f(δ) + ε (q − q₀) = 0, which is
q = W (ε q₀ − Vᵀ f) with W = 1/(λ + ε) and the place q₀ before. With the smallest ε this is equilibrium to ε over the squared
frequency of a block on its joints. Where a crack runs, there is no equilibrium near by, and a laboratory would hear a bang. Steps
with a larger ε are then taken, as if the blocks moved through a viscous fluid, until the smallest one finds a place again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jax import lax
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.mechanics.cohesive_laws import CohesiveLaw, JointLaw
from structid.mechanics.restoring_forces import CollapseError, RestoringForce
from structid.models.masonry.equations.condensed import Condensed
from structid.models.masonry.equations.wall_motion import Fixed, Unknown, jump_solver
from structid.models.masonry.finite_elements.assembly import Assembly, Masonry
from structid.models.masonry.finite_elements.mesh import Mesh

PROXIMAL = np.array([1e2, 1e4, 1e5, 1e6, 1e7, 1e8])
"""ε [1/s²]. A block on its joints has 10⁵ and more; with a smaller first one, rounding would grow."""
STEPS = 120
"""Proximal steps of a move at most."""
BEAM = 3
"""Degrees of freedom of the beam: u_x, u_y [m], and the rotation θ [rad] about the middle of the wall's top."""
LOADINGS = 8
"""Newton iterations of a load step: of the beam, in each of which the joints are in equilibrium."""


@dataclass(frozen=True, eq=False)
class BeamedWall:
    """Matrices of a wall whose top nodes are held by a rigid beam."""

    mesh: Mesh = field(repr=False)  # Of the wall, with its loading beam of bars
    masonry: Masonry  # Materials and loads
    joint_law: JointLaw  # What all joints obey

    @cached_property
    def top_nodes(self) -> np.ndarray:
        """Nodes under the beam, from the left."""
        return np.concatenate([self.mesh.blocks[block][[3, 2]] for block in self.mesh.top_blocks])

    @cached_property
    def condensed(self) -> Condensed:
        """The blocks with the beam at rest, condensed to the jumps of the joints."""
        held = replace(
            self.mesh,
            bars=self.mesh.bars[:0],
            bar_lengths=self.mesh.bar_lengths[:0],
            fixed=np.union1d(self.mesh.fixed, self.top_nodes),
        )
        return Condensed(Assembly(held, self.masonry), self.joint_law)

    def rigid(self, nodes: np.ndarray) -> Float[np.ndarray, "_ 3"]:
        """Displacements of nodes that move with the beam: u_x − θ (y − H), u_y + θ (x − B/2)."""
        wall = self.mesh.wall
        x, y = self.mesh.nodes[nodes, 0] - 0.5 * wall.width, self.mesh.nodes[nodes, 1] - wall.height
        found = np.zeros((2 * len(nodes), BEAM))
        found[0::2, 0], found[1::2, 1] = 1.0, 1.0
        found[0::2, 2], found[1::2, 2] = -y, x
        return found

    @cached_property
    def jumps_of_beam(self) -> np.ndarray:
        """J, shape (jump, 3): jumps where the blocks under the beam move with it, and no other does."""
        assembly, moving = Assembly(self.mesh, self.masonry), self.mesh.blocks[self.mesh.top_blocks].ravel()
        places = np.array([assembly.dof(node, direction) for node in moving for direction in (0, 1)])
        return np.asarray(assembly.jumps[:, places] @ self.rigid(moving))

    @cached_property
    def load(self) -> np.ndarray:
        """Vertical load on the beam, shape (3,) [N], [N], [N m]."""
        shares = Assembly(self.mesh, self.masonry).beam_shares(everywhere=False)
        pushed = np.zeros(BEAM)
        for node, share in shares:
            pushed -= self.masonry.vertical_load * share * self.rigid(np.array([node]))[1]
        return pushed


@dataclass(frozen=True, eq=False)
class StaticWall(RestoringForce):
    """Forces that a wall exerts against a rigid beam on its top; displacements count from where its load has come to rest."""

    wall: BeamedWall = field(repr=False)
    law: CohesiveLaw  # Parameters of the joints; floats, or arrays over runs
    runs: int = 1  # Their number
    farthest: float = 1e-4  # Longest move that is taken in one piece [m]
    compliances: list[Any] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # Made here and not where they are needed first, which may be inside a loop: they are the same in all steps.
        condensed = self.wall.condensed
        weights = [np.broadcast_to(self._weights(epsilon), (len(condensed.squares), self.runs)) for epsilon in PROXIMAL]
        object.__setattr__(self, "compliances", [condensed.compliance(each) for each in weights])

    def _weights(self, epsilon: Any) -> Any:
        """W."""
        return 1.0 / (self.wall.condensed.squares[:, None] + epsilon)

    @property
    def dofs(self) -> int:
        """Motions of the beam."""
        return BEAM

    @property
    def units(self) -> tuple[str, ...]:
        """Two displacements and a rotation."""
        return ("m", "m", "rad")

    @property
    def largest_move(self) -> float:
        """Friction and damage follow the path; see `RestoringForce.largest_move`."""
        return self.farthest

    # --- inside JAX, for many runs ------------------------------------------------------------------------------

    @cached_property
    def _solved(self) -> Callable[..., Any]:
        return jump_solver(self.wall.condensed, 0.0)

    def _at_level(self, values: Any, level: Any) -> Any:
        """That of the proximal step which each run takes."""
        found = values[0]
        for number, value in enumerate(values[1:], start=1):
            found = jnp.where(level == number, value, found)
        return found

    def _stepped(self, memory: Any, beam: Any, level: Any) -> tuple[Any, Any, Any]:
        """One proximal step: forces on the beam, what is remembered there, and which runs found no place; all of shape (…, run)."""
        condensed, runs = self.wall.condensed, beam.shape[1]
        epsilon = self._at_level(PROXIMAL, level)
        weights = self._weights(epsilon)
        compliance = self._at_level(self.compliances, level)
        fixed = Fixed(self.law, compliance, jnp.zeros((len(condensed.jump_rows) // 2, 2, 2, runs)))
        held = weights * epsilon * memory["q"]
        free = self.wall.jumps_of_beam @ beam + condensed.opening.times(held)
        unknown = Unknown(fixed, memory["joints"], free, jnp.zeros_like(free))
        jumps, force, lost = self._solved(unknown, lax.stop_gradient(memory["jumps"]), memory["stands"])
        after = memory | {
            "q": held - weights * condensed.pushing.times(force),
            "jumps": jumps,
            "joints": condensed.remembered(self.law, memory["joints"], jumps),
        }
        return self.wall.jumps_of_beam.T @ force, after, lost

    def _moved(self, memory: Any, beam: Any) -> tuple[Any, Any]:
        """Forces on the beam at a place, and what is remembered there, after as many proximal steps as every run needs."""

        def step(carried: tuple[Any, ...]) -> tuple[Any, ...]:
            memory, force, level, going, count = carried
            found, after, lost = self._stepped(memory, beam, level)
            taken = going & ~lost
            memory = jax.tree.map(lambda new, old: jnp.where(taken, new, old), after, memory)
            force, going = jnp.where(taken, found, force), going & (lost | (level > 0))
            level = jnp.clip(level + jnp.where(lost, 1.0, -1.0), 0.0, len(PROXIMAL) - 1.0)
            return memory, force, level, going, count + 1.0

        runs = beam.shape[1]
        start = memory, jnp.zeros_like(beam), jnp.zeros(runs), memory["stands"], 0.0
        after, force, _, going, _ = lax.while_loop(lambda c: jnp.any(c[3]) & (c[4] < STEPS), step, start)
        return force, after | {"stands": after["stands"] & ~going}

    def _loaded(self, runs: int) -> Any:
        """What is remembered under the vertical load, which comes on in steps; in each the beam finds its place by iterations.

        Both are one loop, so that code is written once.
        """
        condensed = self.wall.condensed
        steps, load = self.wall.joint_law.load_steps, self.wall.load[:, None]
        memory = {
            "q": jnp.zeros((len(condensed.squares), runs)), "jumps": jnp.zeros((len(condensed.jump_rows), runs)),
            "joints": jnp.zeros((self.wall.joint_law.memories, condensed.joints, runs)), "stands": jnp.ones(runs, dtype=bool),
        }  # fmt: skip

        def iterate(carried: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
            memory, beam, count = carried
            step = jnp.floor(count / LOADINGS) + 1.0
            force, slopes, after, lost = self._with_slopes(memory, beam)
            arrived = count + 1.0 >= step * LOADINGS
            after = jax.tree.map(lambda new, old: jnp.where(arrived, new, old), after, memory)
            after["stands"] = after["stands"] & ~(arrived & lost)
            return after, beam + _solved_for_three(slopes, step / steps * load - force), count + 1.0

        last = float(steps * LOADINGS)
        begun = memory, jnp.zeros((BEAM, runs)), 0.0
        after, beam, _ = lax.while_loop(lambda carried: carried[2] < last, iterate, begun)
        return after | {"rest": beam}

    def _with_slopes(self, memory: Any, beam: Any) -> tuple[Any, Any, Any, Any]:
        """A proximal step with the smallest ε: forces on the beam and their slopes (3, 3, run), memory, and who found no place.

        The slopes are Jᵀ G δ̇ with δ̇ = (I + F G)⁻¹ J.
        """
        condensed, runs = self.wall.condensed, beam.shape[1]
        force, after, lost = self._stepped(memory, beam, jnp.zeros(runs))
        tangent = condensed.forces(self.law, memory["joints"], after["jumps"])[1]
        columns = []
        for column in self.wall.jumps_of_beam.T:
            right = jnp.broadcast_to(column[:, None], (len(column), runs))
            jumps = condensed.pattern.solve_one_plus(self.compliances[0], tangent, right).reshape(-1, 2, runs)
            pushed = jnp.einsum("gabr,gbr->gar", tangent, jumps).reshape(-1, runs)
            columns.append(self.wall.jumps_of_beam.T @ pushed)
        return force, jnp.stack(columns, axis=1), after, lost

    # --- the face -----------------------------------------------------------------------------------------------

    def force_at_rest(self, displacement: Float[Array, "3 *run"]) -> Any:
        """The vertical load; see `RestoringForce.force_at_rest`."""
        return displacement + (self.wall.load if displacement.ndim == 1 else self.wall.load[:, None])

    def at_rest(self, displacement: Float[Array, "3 *run"]) -> Any:
        """The wall under its load; see `RestoringForce.at_rest`."""
        if displacement.ndim == 2:
            return self._loaded(displacement.shape[1])
        memory = jax.tree.map(np.asarray, self._compiled_load())
        if not (memory["stands"].all() and np.isfinite(memory["rest"]).all()):
            raise CollapseError("no equilibrium was found under the vertical load")
        return memory

    def at(self, memory: Any, displacement: Float[Array, "3 *run"]) -> tuple[Any, Any]:
        """Move the beam; see `RestoringForce.at`."""
        if displacement.ndim == 2:
            force, after = self._moved(memory, memory["rest"] + displacement)
            return jnp.where(after["stands"], force, jnp.nan), after
        force, after = jax.tree.map(np.asarray, self._compiled_move(memory, memory["rest"] + displacement[:, None]))
        if not after["stands"].all():
            raise CollapseError(f"its joints find no equilibrium with the beam at {1e3 * displacement[0]:.2f} mm")
        self._check_support(after["jumps"][:, 0])
        return force[:, 0], after

    def _check_support(self, jumps: np.ndarray) -> None:
        """Refuse to go on where a bed joint has lost what lies on it."""
        mesh = self.wall.mesh
        count = 2 * len(mesh.joints)
        lost = (np.stack([jumps[0:count:2], np.abs(jumps[1:count:2])], axis=1) / mesh.support).max(axis=1)
        worst = int(np.argmax(lost))
        if lost[worst] >= 1.0:
            raise CollapseError(f"the joint {mesh.joints[worst].name} lost what lies on it")

    @cached_property
    def _compiled_move(self) -> Callable[..., Any]:
        compiled: Callable[..., Any] = jax.jit(self._moved)
        return compiled

    @cached_property
    def _compiled_load(self) -> Callable[[], Any]:
        compiled: Callable[[], Any] = jax.jit(lambda: self._loaded(1))
        return compiled

    def initial_stiffness(self) -> Float[np.ndarray, "3 3"]:
        """Tangent of the wall under its load, symmetric part."""
        memory = self.at_rest(np.zeros(BEAM))
        slopes = np.asarray(jax.jit(self._with_slopes)(memory, memory["rest"])[1])[:, :, 0]
        return np.asarray(0.5 * (slopes + slopes.T))


def _solved_for_three(matrix: Any, right: Any) -> Any:
    """X of A x = b by Cramer's rule: A (3, 3, run), b (3, run). It has vector code, and a general solution has not."""
    a, b, c = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    across = _cross(b, c)
    volume = (a * across).sum(axis=0)
    return (
        jnp.stack(
            [(right * across).sum(axis=0), (a * _cross(right, c)).sum(axis=0), (a * _cross(b, right)).sum(axis=0)]
        )
        / volume
    )


def _cross(x: Any, y: Any) -> Any:
    """X × y, shape (3, run)."""
    return jnp.stack([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])
