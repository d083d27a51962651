"""Forces of a wall on a slowly moving rigid beam on its top, without inertia.

The blocks under the beam move with it. q are the modal displacements of the blocks with the beam at rest. J d are the
jumps if the beam moves by d and q = 0. Equilibrium is

Λ q + Vᵀ f(δ) = 0,    δ = V q + J d,    forces on the beam  r = Jᵀ f(δ).

Blocks held only by joints have modes with λ = 0. Proximal steps therefore determine q: Λ q + Vᵀ f(δ) + ε (q − q₀) = 0,
which gives q = W (ε q₀ − Vᵀ f) with W = 1/(λ + ε) and the previous q₀. With the smallest ε, the relative error of
equilibrium is ε divided by the squared frequency of a block on its joints. While a crack propagates, there is no
equilibrium near the current state. Steps with a larger ε then damp the motion, like a viscous fluid, until the smallest
ε converges again.
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
"""Values of ε [1/s²]. A block on its joints has a squared circular frequency of at least 10⁵. A smaller first ε would
amplify rounding errors."""
STEPS = 120
"""Largest number of proximal steps for one displacement of the beam."""
BEAM = 3
"""Degrees of freedom of the beam: u_x, u_y [m], and the rotation θ [rad] about the middle of the wall's top."""
LOADINGS = 8
"""Number of Newton iterations for the position of the beam in a load step."""


@dataclass(frozen=True, eq=False)
class BeamedWall:
    """Matrices of a wall whose top nodes are held by a rigid beam."""

    mesh: Mesh = field(repr=False)  # mesh of the wall, with its loading beam of bars
    masonry: Masonry  # materials and loads
    joint_law: JointLaw  # law of all joints

    @cached_property
    def top_nodes(self) -> np.ndarray:
        """Nodes under the beam, from left to right."""
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
        """Return the displacements of nodes that move with the beam: u_x − θ (y − H), u_y + θ (x − B/2)."""
        wall = self.mesh.wall
        x, y = self.mesh.nodes[nodes, 0] - 0.5 * wall.width, self.mesh.nodes[nodes, 1] - wall.height
        matrix = np.zeros((2 * len(nodes), BEAM))
        matrix[0::2, 0], matrix[1::2, 1] = 1.0, 1.0
        matrix[0::2, 2], matrix[1::2, 2] = -y, x
        return matrix

    @cached_property
    def jumps_of_beam(self) -> np.ndarray:
        """Matrix J, shape (jump, 3): jumps per unit motion of the beam if only the blocks under the beam move."""
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
    """Forces of a wall on a rigid beam on top; displacements are measured from the loaded wall at rest."""

    wall: BeamedWall = field(repr=False)
    law: CohesiveLaw  # parameters of the joints; floats, or arrays over runs
    runs: int = 1  # number of runs
    farthest: float = 1e-4  # largest displacement increment in one piece [m]
    compliances: list[Any] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # The compliances are equal in all steps. They are computed here, because the first use may be inside a loop.
        condensed = self.wall.condensed
        weights = [np.broadcast_to(self._weights(epsilon), (len(condensed.squares), self.runs)) for epsilon in PROXIMAL]
        object.__setattr__(self, "compliances", [condensed.compliance(each) for each in weights])

    def _weights(self, epsilon: Any) -> Any:
        """Return W."""
        return 1.0 / (self.wall.condensed.squares[:, None] + epsilon)

    @property
    def dofs(self) -> int:
        """Number of degrees of freedom of the beam."""
        return BEAM

    @property
    def units(self) -> tuple[str, ...]:
        """Units of two displacements and a rotation."""
        return ("m", "m", "rad")

    @property
    def largest_move(self) -> float:
        """Largest increment, since friction and damage depend on the path; see `RestoringForce.largest_move`."""
        return self.farthest

    # --- inside JAX, for many runs ------------------------------------------------------------------------------

    @cached_property
    def _solved(self) -> Callable[..., Any]:
        return jump_solver(self.wall.condensed, 0.0)

    def _at_level(self, values: Any, level: Any) -> Any:
        """Select for each run the value that belongs to its current level of ε."""
        result = values[0]
        for number, value in enumerate(values[1:], start=1):
            result = jnp.where(level == number, value, result)
        return result

    def _stepped(self, memory: Any, beam: Any, level: Any) -> tuple[Any, Any, Any]:
        """Take one proximal step: return forces on the beam, memory and a mask of unconverged runs, all of shape (…, run)."""
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
        """Return the forces on the beam at a displacement, and the memory, after as many proximal steps as each run needs."""

        def step(carried: tuple[Any, ...]) -> tuple[Any, ...]:
            memory, force, level, going, count = carried
            result, after, lost = self._stepped(memory, beam, level)
            accepted = going & ~lost
            memory = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), after, memory)
            force, going = jnp.where(accepted, result, force), going & (lost | (level > 0))
            level = jnp.clip(level + jnp.where(lost, 1.0, -1.0), 0.0, len(PROXIMAL) - 1.0)
            return memory, force, level, going, count + 1.0

        runs = beam.shape[1]
        start = memory, jnp.zeros_like(beam), jnp.zeros(runs), memory["stands"], 0.0
        after, force, _, going, _ = lax.while_loop(lambda c: jnp.any(c[3]) & (c[4] < STEPS), step, start)
        return force, after | {"stands": after["stands"] & ~going}

    def _loaded(self, runs: int) -> Any:
        """Return the joint states under the vertical load. In each load step, Newton iterations determine the beam's position.

        Load steps and iterations form a single loop, so that the code of its body is generated only once.
        """
        condensed = self.wall.condensed
        steps, load = self.wall.joint_law.load_steps, self.wall.load[:, None]
        memory = {
            "q": jnp.zeros((len(condensed.squares), runs)),
            "jumps": jnp.zeros((len(condensed.jump_rows), runs)),
            "joints": jnp.zeros((self.wall.joint_law.memories, condensed.joints, runs)),
            "stands": jnp.ones(runs, dtype=bool),
        }

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
        """Take a proximal step with the smallest ε: return beam forces, their slopes (3, 3, run), memory, mask of unconverged runs.

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

    # --- interface ----------------------------------------------------------------------------------------------

    def force_at_rest(self, displacement: Float[Array, "3 *run"]) -> Any:
        """Return the vertical load; see `RestoringForce.force_at_rest`."""
        return displacement + (self.wall.load if displacement.ndim == 1 else self.wall.load[:, None])

    def at_rest(self, displacement: Float[Array, "3 *run"]) -> Any:
        """Return the memory of the loaded wall; see `RestoringForce.at_rest`."""
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
            raise CollapseError(f"no equilibrium was found at a beam displacement of {1e3 * displacement[0]:.2f} mm")
        self._check_support(after["jumps"][:, 0])
        return force[:, 0], after

    def _check_support(self, jumps: np.ndarray) -> None:
        """Raise an error if a bed joint has lost its support."""
        mesh = self.wall.mesh
        count = 2 * len(mesh.joints)
        lost = (np.stack([jumps[0:count:2], np.abs(jumps[1:count:2])], axis=1) / mesh.support).max(axis=1)
        worst = int(np.argmax(lost))
        if lost[worst] >= 1.0:
            raise CollapseError(f"the joint {mesh.joints[worst].name} lost its support")

    @cached_property
    def _compiled_move(self) -> Callable[..., Any]:
        compiled: Callable[..., Any] = jax.jit(self._moved)
        return compiled

    @cached_property
    def _compiled_load(self) -> Callable[[], Any]:
        compiled: Callable[[], Any] = jax.jit(lambda: self._loaded(1))
        return compiled

    def initial_stiffness(self) -> Float[np.ndarray, "3 3"]:
        """Symmetric part of the tangent of the loaded wall."""
        memory = self.at_rest(np.zeros(BEAM))
        slopes = np.asarray(jax.jit(self._with_slopes)(memory, memory["rest"])[1])[:, :, 0]
        return np.asarray(0.5 * (slopes + slopes.T))


def _solved_for_three(matrix: Any, right: Any) -> Any:
    """Solve A x = b for shapes (3, 3, run) and (3, run) by Cramer's rule, which can be compiled to vector code."""
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
    """Return x × y, shape (3, run)."""
    return jnp.stack([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])
