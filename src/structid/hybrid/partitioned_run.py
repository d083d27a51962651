"""Two coupled parts over a record, and the histories of both on their two clocks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from structid.errors import InputError
from structid.ground_motion.record import GroundMotion
from structid.hybrid.coupling import CoarseStep, CoupledState, Joined
from structid.hybrid.operator_splitting import PartState


@dataclass(frozen=True, eq=False)
class PartHistory:
    """Motion of one part; see `PartState`.

    Parameters
    ----------
    time : ndarray, shape (time,)
        [s].
    displacement, velocity, acceleration, force : ndarray, shape (time, dof)
        u [m], v [m/s], a [m/s²], r [N].
    imposed, reading : ndarray, shape (time, dof)
        ũ, and the force r̃ that was found there.
    """

    time: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    force: np.ndarray
    imposed: np.ndarray
    reading: np.ndarray

    @classmethod
    def of(cls, time: np.ndarray, states: list[PartState]) -> PartHistory:
        """Gather states.

        Parameters
        ----------
        time : ndarray, shape (time,)
            When they were [s].
        states : list of PartState
            One for each time.

        Returns
        -------
        PartHistory
            Of all.
        """
        return cls(time, *(np.stack([np.asarray(s[i]) for s in states]) for i in range(6)))


@dataclass(frozen=True, eq=False)
class CoarseHistory:
    """The structure at the end of every coarse step, first of all at rest.

    Parameters
    ----------
    time : ndarray, shape (time,)
        [s].
    u, v, a : ndarray, shape (time, dof)
        Displacement, velocity and acceleration of the degrees of freedom of the physical part, then of those of the numerical part
        that are not at the interface.
    traction : ndarray, shape (time, interface)
        Λ [N].
    gap : ndarray, shape (time,)
        Difference of the displacements of both parts at the interface [m].
    pseudo_energy : ndarray, shape (time,)
        Of the interface in each step [W/s].
    numerical, physical : PartHistory
        Of the parts.
    """

    time: np.ndarray
    u: np.ndarray
    v: np.ndarray
    a: np.ndarray
    traction: np.ndarray
    gap: np.ndarray
    pseudo_energy: np.ndarray
    numerical: PartHistory
    physical: PartHistory


@dataclass(frozen=True, eq=False)
class FineHistory:
    """The fine part at the end of every fine step.

    Parameters
    ----------
    part : PartHistory
        Its motion. What the coupling adds at the end of a coarse step is in `CoarseHistory` and not here.
    traction : ndarray, shape (time, interface)
        Λ that it felt [N].
    """

    part: PartHistory
    traction: np.ndarray


@dataclass(frozen=True, eq=False)
class PartitionedHistories:
    """Histories on the two clocks.

    Parameters
    ----------
    coarse : CoarseHistory
        Of both parts.
    fine : FineHistory
        Of the fine part.
    """

    coarse: CoarseHistory
    fine: FineHistory


def steps_over(joined: Joined, start: CoupledState, base: np.ndarray) -> Iterator[CoarseStep]:
    """Take every coarse step of a record.

    Parameters
    ----------
    joined : Joined
        The coupled structure.
    start : CoupledState
        Before the first step, from `Joined.start`, which reads a specimen once.
    base : ndarray, shape (steps · ss + 1,)
        Acceleration of the base at every fine step [m/s²].

    Yields
    ------
    CoarseStep
        One after the other.
    """
    state, count = start, joined.substeps
    for first in range(0, len(base) - 1, count):
        step = joined.step(state, base[first : first + count + 1])
        yield step
        state = step.state


def base_of(record: GroundMotion, joined: Joined, duration: float | None = None) -> np.ndarray:
    """Acceleration of the base at every fine step.

    Parameters
    ----------
    record : GroundMotion
        The record.
    joined : Joined
        Whose steps they are.
    duration : float, optional
        How much of it [s]; all when left out.

    Returns
    -------
    ndarray, shape (steps · ss + 1,)
        [m/s²].

    Raises
    ------
    InputError
        If not one coarse step fits into it.
    """
    length = record.duration if duration is None else duration
    steps = int(np.floor(length / joined.dt + 1e-9))
    if steps < 1:
        raise InputError("dt", f"{joined.dt:g} s, and the record lasts {length:g} s", "a coarse step that fits into it")
    return record.values_at(np.arange(steps * joined.substeps + 1) * joined.fine.step)


def histories_of(joined: Joined, start: CoupledState, steps: Iterable[CoarseStep]) -> PartitionedHistories:
    """Gather what happened in the steps.

    Parameters
    ----------
    joined : Joined
        The coupled structure.
    start : CoupledState
        Before the first step.
    steps : iterable of CoarseStep
        In their order.

    Returns
    -------
    PartitionedHistories
        On both clocks.
    """
    taken = list(steps)
    states = [start, *(step.state for step in taken)]
    time = np.arange(len(states)) * joined.dt
    numerical = PartHistory.of(time, [s.numerical for s in states])
    physical = PartHistory.of(time, [s.physical for s in states])
    inner = ~np.any(joined.numerical.rows != 0.0, axis=0)

    def of_both(name: str) -> np.ndarray:
        return np.concatenate([getattr(physical, name), getattr(numerical, name)[:, inner]], axis=1)

    coarse = CoarseHistory(
        time,
        of_both("displacement"),
        of_both("velocity"),
        of_both("acceleration"),
        np.stack([s.traction for s in states]),
        np.array([joined.gap(s) for s in states]),
        np.array([0.0, *(step.pseudo_energy for step in taken)]),
        numerical,
        physical,
    )
    fine_time = np.arange(1, len(taken) * joined.substeps + 1) * joined.fine.step
    nothing = np.zeros((0, joined.fine.part.dofs))
    columns = [np.concatenate([nothing, *(np.asarray(step.fine.part[k]) for step in taken)]) for k in range(6)]
    tractions = np.concatenate([np.zeros((0, len(joined.fine.rows))), *(step.fine.traction for step in taken)])
    return PartitionedHistories(coarse, FineHistory(PartHistory(fine_time, *columns), tractions))


def run_over(joined: Joined, base: np.ndarray) -> PartitionedHistories:
    """Run both parts over a record.

    Parameters
    ----------
    joined : Joined
        The coupled structure.
    base : ndarray, shape (steps · ss + 1,)
        Acceleration of the base at every fine step [m/s²].

    Returns
    -------
    PartitionedHistories
        On both clocks.
    """
    start = joined.start(base[0])
    return histories_of(joined, start, steps_over(joined, start, base))
