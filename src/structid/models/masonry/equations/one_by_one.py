"""Runs of a large wall, one at a time, with sparse factorisation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from structid.core.errors import ConvergenceError, Status
from structid.core.progress import Progress
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.mechanics.cohesive_laws import CohesiveLaw
from structid.models.masonry.equations.condensed import Condensed
from structid.models.masonry.equations.dense_newton import DenseHistory, DenseWall, simulate
from structid.models.masonry.equations.loaded_wall import Loaded
from structid.models.masonry.equations.sparse_newton import SparseWall
from structid.models.masonry.equations.wall_channels import WallChannels, Works
from structid.models.masonry.equations.wall_motion import WallState


def runs_one_by_one(
    condensed: Condensed,
    laws: list[tuple[CohesiveLaw, float]],
    channels: tuple[str, ...],
    excitation: Excitation,
    substeps: int,
    progress: Progress | None = None,
) -> Histories:
    """Run a wall with several parameter sets for its joints."""
    stages = excitation.stage_values(substeps)
    base, dt = np.append(stages[:, :, 0].ravel(), stages[-1, -1, 2]), excitation.dt / substeps
    values = np.full((len(laws), len(excitation), len(channels)), np.nan)
    status, time = np.full(len(laws), Status.DONE), np.full(len(laws), np.nan)
    for run, (law, ratio) in enumerate(laws):
        wall = SparseWall(condensed.assembly, condensed.joint_law, law)
        try:
            history = simulate(wall, base, dt, ratio)
        except ConvergenceError:  # the wall does not carry its load
            status[run], time[run] = Status.DIVERGED, 0.0
        else:
            outputs = recorded(condensed, wall, history, channels, dt, ratio)[::substeps]
            values[run, : len(outputs)] = outputs
            if not history.converged:
                status[run], time[run] = Status.DIVERGED, len(history.u) * dt
        if progress is not None:
            progress(run + 1, len(laws))
    return Histories(values, excitation.dt, channels, status, time, excitation.name, ("",) * len(laws))


def recorded(
    condensed: Condensed, wall: DenseWall, history: DenseHistory, channels: tuple[str, ...], dt: float, ratio: float
) -> Float[np.ndarray, "time channel"]:
    """Compute the channels of a history for all instants at once, with the instants along the run axis."""
    modal = condensed.shapes.T @ wall.matrices.mass
    q, rate, acceleration = (modal @ series.T for series in (history.u, history.v, history.a))
    jumps, jump_rate = condensed.jump_rows @ q, condensed.jump_rows @ rate
    memory = history.memory.transpose(1, 2, 0)
    states = WallState(q, rate, acceleration, jumps, jumps, jumps, jump_rate, memory, np.ones(q.shape[1], dtype=bool))
    at_rest = _at_rest(condensed, wall, q[:, :1], memory[:, :, :1], history, ratio)
    observed = WallChannels(condensed, channels, wall.law, at_rest, dt)
    works = Works(*np.zeros((3, q.shape[1])))
    if observed.added_up and q.shape[1] > 1:
        before, after = (WallState(*(x[..., part] for x in states)) for part in (slice(None, -1), slice(1, None)))
        nothing = Works(*np.zeros((3, q.shape[1] - 1)))
        steps = observed.added(nothing, before, after, (history.base[:-1], history.base[1:]))
        works = Works(*(np.concatenate([[0.0], np.cumsum(np.asarray(part))]) for part in steps))
    return np.asarray(observed.observe(states, works, history.base)).T


def _at_rest(
    condensed: Condensed, wall: DenseWall, q: np.ndarray, memory: np.ndarray, history: DenseHistory, ratio: float
) -> Loaded:
    a_0, a_1 = wall.rayleigh(history.u[0], history.memory[0], ratio)
    tangent = np.asarray(condensed.forces(wall.law, memory, condensed.jump_rows @ q)[1])
    return Loaded(q, np.array([a_0]), np.array([a_1]), memory, 0.5 * (tangent + tangent.transpose(0, 2, 1, 3)))
