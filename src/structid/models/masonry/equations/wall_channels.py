"""Channels of a moving wall: point displacements, base shear, state of the joints, energies."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError, suggestion
from structid.engine.device import jnp
from structid.engine.matrices.block_sparse import SparseMatrix
from structid.mechanics.cohesive_laws import CohesiveLaw
from structid.models.masonry.equations.condensed import Condensed
from structid.models.masonry.equations.loaded_wall import Loaded
from structid.models.masonry.equations.wall_motion import WallState
from structid.models.masonry.finite_elements.mesh import Mesh

CHANNELS = (
    *("drift", "base_shear", "largest_opening", "largest_slip", "largest_penetration", "support_lost", "weakest_joint"),
    *("kinetic_energy", "strain_energy", "joint_energy", "damping_energy", "input_energy", "load_energy"),
)
"""Channels other than point displacements."""
ADDED_UP = ("joint_energy", "damping_energy", "input_energy")
"""Energy channels that accumulate the work of every step."""
_POINT = re.compile(r"u([xy])_(top_left|top_right|node_(\d+))")
_GAUSS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]), np.array([5.0, 8.0, 5.0]) / 9.0


class Works(NamedTuple):
    """Accumulated energies [J]; each has shape (run,)."""

    joints: Any  # work of the joint forces on their jumps
    damping: Any  # work of the damping forces
    base: Any  # work of the base motion on the wall


def check_wall_channels(mesh: Mesh, channels: tuple[str, ...]) -> tuple[str, ...]:
    """Refuse channels that a wall does not have."""
    names = (channels,) if isinstance(channels, str) else tuple(channels)
    allowed = f"ux_top_left, uy_top_right, ux_node_0 to uy_node_{len(mesh.nodes) - 1}, {', '.join(CHANNELS)}"
    for name in names:
        if name not in CHANNELS and not _POINT.fullmatch(name):
            available = ("ux_top_left", "uy_top_left", "ux_top_right", "uy_top_right", *CHANNELS)
            raise InputError("MasonryWall.channels", f"'{name}'", allowed, suggestion(str(name), available))
        if name not in CHANNELS:
            node, _ = point_of(mesh, name)
            if node >= len(mesh.nodes) or node in mesh.fixed:
                raise InputError("MasonryWall.channels", f"'{name}' belongs to a fixed or missing node", allowed)
    if not names or len(set(names)) < len(names):
        raise InputError("MasonryWall.channels", f"{list(names)}", f"one or more of {allowed}, each once")
    return names


def is_point(channel: str) -> bool:
    """Whether a channel name is that of a point displacement."""
    return _POINT.fullmatch(channel) is not None


def point_of(mesh: Mesh, channel: str) -> tuple[int, int]:
    """Return the node and direction of a point displacement."""
    match = _POINT.fullmatch(channel)
    assert match is not None
    node = int(match.group(3)) if match.group(3) else mesh.corner(match.group(2))
    return node, "xy".index(match.group(1))


@dataclass(frozen=True, eq=False)
class WallChannels:
    """Channels of a batch of runs, inside JAX."""

    condensed: Condensed = field(repr=False)  # equations of the wall
    channels: tuple[str, ...]  # recorded channels
    law: CohesiveLaw  # parameters of the joints
    loaded: Loaded  # the wall at rest
    dt: float  # step [s]
    _drift_at_rest: Any = field(init=False, repr=False)
    _strain_at_rest: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # These constants are computed once, before the loop.
        start = self.loaded.q
        object.__setattr__(self, "_drift_at_rest", (self._points.dense[-1:] @ start)[0])
        object.__setattr__(self, "_strain_at_rest", self._strain(start, self.condensed.jump_rows @ start))

    @property
    def added_up(self) -> bool:
        """Whether a recorded channel accumulates the work of every step."""
        return bool(set(ADDED_UP) & set(self.channels))

    @cached_property
    def _points(self) -> SparseMatrix:
        """Matrix for the displacements of the recorded points in order, and for the drift."""
        mesh, assembly, rows = self.condensed.assembly.mesh, self.condensed.assembly, []
        for channel in (*(c for c in self.channels if c not in CHANNELS), "ux_top_left"):
            node, direction = point_of(mesh, channel)
            rows.append(self.condensed.shapes[assembly.dof(node, direction)])
        return SparseMatrix(np.array(rows))

    def nothing(self, runs: int) -> Works:
        """Return the accumulated energies before the first step, which are zero."""
        return Works(*(jnp.zeros(runs) for _ in Works._fields))

    def added(self, works: Works, before: WallState, after: WallState, base: tuple[Any, Any]) -> Works:
        """Add the work of a step to the accumulated energies.

        The work of the joint forces is ∫ f dδ along a straight line from the jumps before the step to those after it,
        by three Gauss points. With average acceleration the work of the damping forces is Δt vᵀ C v, with the mean
        velocity v. The work of the base motion is −½ (a_g + a_g′) ιᵀ M Δu.
        """
        c, count = self.condensed, 2 * self.condensed.joints
        move = (after.jumps - before.jumps)[:count]
        middle = 0.5 * (after.jumps + before.jumps)
        joints = works.joints
        for abscissa, weight in zip(*_GAUSS, strict=True):
            force, _ = c.forces(self.law, before.memory, middle + 0.5 * abscissa * (after.jumps - before.jumps))
            joints = joints + 0.5 * weight * jnp.sum(force[:count] * move, axis=0)
        rate, jump_rate = 0.5 * (after.rate + before.rate), 0.5 * (after.jump_rate + before.jump_rate)
        block_damping = jnp.sum((self.loaded.a_0 + self.loaded.a_1 * c.squares[:, None]) * rate**2, axis=0)
        pairs = jump_rate.reshape(-1, 2, jump_rate.shape[1])
        dashpots = self.loaded.a_1 * jnp.einsum("gar,gabr,gbr->r", pairs, self.loaded.tangent, pairs)
        pushed = -0.5 * (base[0] + base[1]) * jnp.sum(c.inertia[:, None] * (after.q - before.q), axis=0)
        return Works(joints, works.damping + self.dt * (block_damping + dashpots), works.base + pushed)

    def observe(self, state: WallState, works: Works, base: Any) -> Float[Array, "channel run"]:
        """Compute the channels at an instant."""
        points, of_the_wall = self._points.times(state.q), self._of_the_wall
        rows, number = [], 0
        for channel in self.channels:
            if channel in of_the_wall:
                rows.append(of_the_wall[channel](state, works, base, points[-1]))
            else:
                rows.append(points[number])
                number += 1
        return jnp.stack(rows)

    def _lost(self, jumps: Any) -> Any:
        """Return the fraction of its support that each joint has lost, shape (joint, run); 1 means complete loss."""
        count, limits = 2 * self.condensed.joints, self.condensed.assembly.mesh.support
        opened, slid = jumps[0:count:2] / limits[:, :1], jnp.abs(jumps[1:count:2]) / limits[:, 1:]
        return jnp.maximum(opened, slid)

    def _weakest(self, jumps: Any) -> Any:
        """Return the index of the joint that has lost the largest fraction of its support, shape (run,)."""
        lost = self._lost(jumps)
        numbers = jnp.arange(lost.shape[0], dtype=float)[:, None]
        return jnp.max(jnp.where(lost >= jnp.max(lost, axis=0), numbers, 0.0), axis=0)

    def _strain(self, q: Any, jumps: Any) -> Any:
        """Return the strain energy of blocks and bars, shape (run,)."""
        c = self.condensed
        bars = jnp.sum(c.bars[:, None] * jumps[2 * c.joints :] ** 2, axis=0)
        return 0.5 * (jnp.sum(c.squares[:, None] * q**2, axis=0) + bars)

    @property
    def _of_the_wall(self) -> dict[str, Callable[[WallState, Works, Any, Any], Any]]:
        c, count = self.condensed, 2 * self.condensed.joints
        total = float(c.assembly.horizontal @ c.assembly.mass @ c.assembly.horizontal)
        return {
            "drift": lambda s, w, base, top: top - self._drift_at_rest,
            "base_shear": lambda s, w, base, top: -jnp.sum(c.inertia[:, None] * s.acceleration, axis=0) - total * base,
            "largest_opening": lambda s, w, base, top: jnp.max(s.jumps[0:count:2], axis=0),
            "largest_slip": lambda s, w, base, top: jnp.max(jnp.abs(s.jumps[1:count:2]), axis=0),
            "largest_penetration": lambda s, w, base, top: jnp.max(-s.jumps[0:count:2], axis=0),
            "support_lost": lambda s, w, base, top: jnp.max(self._lost(s.jumps), axis=0),
            "weakest_joint": lambda s, w, base, top: self._weakest(s.jumps),
            "kinetic_energy": lambda s, w, base, top: 0.5 * jnp.sum(s.rate**2, axis=0),
            "strain_energy": lambda s, w, base, top: self._strain(s.q, s.jumps) - self._strain_at_rest,
            "joint_energy": lambda s, w, base, top: w.joints,
            "damping_energy": lambda s, w, base, top: w.damping,
            "input_energy": lambda s, w, base, top: w.base,
            "load_energy": lambda s, w, base, top: jnp.sum(c.load[:, None] * (s.q - self.loaded.q), axis=0),
        }
