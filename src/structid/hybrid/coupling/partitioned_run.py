"""Response of two coupled parts to a record, and its histories at coarse and fine steps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError
from structid.ground_motion.record import GroundMotion
from structid.hybrid.coupling.base import CoarseStep, CoupledState, Joined


@dataclass(frozen=True, eq=False)
class PartHistory:
    """History of one part; see `PartState`."""

    time: Float[np.ndarray, " time"]  # [s]
    displacement: Float[np.ndarray, "time dof"]  # u [m]
    velocity: Float[np.ndarray, "time dof"]  # v [m/s]
    acceleration: Float[np.ndarray, "time dof"]  # a [m/s²]
    force: Float[np.ndarray, "time dof"]  # r [N]
    imposed: Float[np.ndarray, "time dof"]  # ũ [m]
    reading: Float[np.ndarray, "time dof"]  # r̃ [N]


@dataclass(frozen=True, eq=False)
class CoarseHistory:
    """History of the structure: initial state at rest, and the end of every coarse step."""

    time: Float[np.ndarray, " time"]  # [s]
    # Order: degrees of freedom of the physical part, then degrees of freedom of the numerical part outside the interface
    u: Float[np.ndarray, "time dof"]  # displacement [m]
    v: Float[np.ndarray, "time dof"]  # velocity [m/s]
    a: Float[np.ndarray, "time dof"]  # acceleration [m/s²]
    traction: Float[np.ndarray, "time interface"]  # Λ [N]
    gap: Float[np.ndarray, " time"]  # difference of the displacements of both parts at the interface [m]
    pseudo_energy: Float[np.ndarray, " time"]  # pseudo-energy of the interface in each step [W/s]
    numerical: PartHistory  # numerical part
    physical: PartHistory  # physical part


@dataclass(frozen=True, eq=False)
class FineHistory:
    """History of the fine part at the end of every fine step."""

    # Without the correction of the coupling at the end of a coarse step, which is in `CoarseHistory`
    part: PartHistory
    traction: Float[np.ndarray, "time interface"]  # Λ on the fine part [N]


@dataclass(frozen=True, eq=False)
class PartitionedHistories:
    """Histories at coarse and fine steps."""

    coarse: CoarseHistory  # both parts at coarse steps
    fine: FineHistory  # fine part at fine steps


def steps_over(coupled: Joined, start: CoupledState, base: Float[np.ndarray, " _"]) -> Iterator[CoarseStep]:
    """Take all coarse steps of a record, one after another."""
    state, count = start, coupled.substeps
    for first in range(0, len(base) - 1, count):
        step = coupled.step(state, base[first : first + count + 1])
        yield step
        state = step.state


def base_of(record: GroundMotion, coupled: Joined, duration: float | None = None) -> Float[np.ndarray, " _"]:
    """Return the base acceleration at every fine step."""
    length = record.duration if duration is None else duration
    steps = int(np.floor(length / coupled.dt + 1e-9))
    if steps < 1:
        raise InputError(
            "dt", f"{coupled.dt:g} s for a record of {length:g} s", "a coarse step no longer than the record"
        )
    return record.values_at(np.arange(steps * coupled.substeps + 1) * coupled.fine.step)


@dataclass(frozen=True, eq=False)
class StepFrame:
    """Layout of a row of numbers that stores one step; it converts steps to rows, and rows to histories."""

    numerical_rows: Float[np.ndarray, "interface dof"]  # L of the numerical part, with its sign
    physical_rows: Float[np.ndarray, "interface physical_dof"]  # L of the physical part, with its sign
    dt: float  # Δt [s]
    substeps: int  # ss
    fine_is_physical: bool  # whether the physical part takes fine steps

    @classmethod
    def of(cls, coupled: Joined) -> StepFrame:
        """The layout of coupled parts."""
        return cls(
            coupled.numerical.rows, coupled.physical.rows, coupled.dt, coupled.substeps, coupled.fine_is_physical
        )

    @cached_property
    def _shapes(self) -> dict[str, tuple[int, ...]]:
        interface, numerical = self.numerical_rows.shape
        physical = self.physical_rows.shape[1]
        return {
            "numerical": (6, numerical),
            "physical": (6, physical),
            "traction": (interface,),
            "pseudo_energy": (1,),
            "fine": (6, self.substeps, physical if self.fine_is_physical else numerical),
            "fine_traction": (self.substeps, interface),
        }

    @cached_property
    def width(self) -> int:
        """Number of values in a row."""
        return sum(math.prod(shape) for shape in self._shapes.values())

    def row_of(self, step: CoarseStep) -> Float[np.ndarray, " width"]:
        """Write a step as a row."""
        fine = (*step.fine.part.recorded(), step.fine.traction)
        return np.concatenate([_numbers(step.state), np.atleast_1d(step.pseudo_energy), *(np.ravel(x) for x in fine)])

    def start_of(self, start: CoupledState) -> Float[np.ndarray, " width"]:
        """Write the initial state as a step without fine states."""
        numbers = _numbers(start)
        return np.concatenate([numbers, np.zeros(self.width - len(numbers))])

    def histories(self, rows: Float[np.ndarray, "_ width"]) -> PartitionedHistories:
        """Read rows as histories."""
        ends = np.cumsum([math.prod(shape) for shape in self._shapes.values()])[:-1]
        pieces = zip(self._shapes.items(), np.split(rows, ends, axis=1), strict=True)
        read = {name: piece.reshape(len(rows), *shape) for (name, shape), piece in pieces}
        time = np.arange(len(rows)) * self.dt
        numerical, physical = (PartHistory(time, *np.moveaxis(read[name], 1, 0)) for name in ("numerical", "physical"))
        inner = ~np.any(self.numerical_rows != 0.0, axis=0)

        def of_both(name: str) -> np.ndarray:
            return np.concatenate([getattr(physical, name), getattr(numerical, name)[:, inner]], axis=1)

        apart = numerical.displacement @ self.numerical_rows.T + physical.displacement @ self.physical_rows.T
        coarse = CoarseHistory(
            time,
            of_both("displacement"),
            of_both("velocity"),
            of_both("acceleration"),
            read["traction"],
            np.abs(apart).max(axis=1),
            read["pseudo_energy"][:, 0],
            numerical,
            physical,
        )
        fine_time = np.arange(1, (len(rows) - 1) * self.substeps + 1) * self.dt / self.substeps
        within, tractions = read["fine"][1:], read["fine_traction"][1:]
        columns = np.moveaxis(within, 1, 0).reshape(6, len(fine_time), within.shape[-1])
        tractions = tractions.reshape(len(fine_time), tractions.shape[-1])
        return PartitionedHistories(coarse, FineHistory(PartHistory(fine_time, *columns), tractions))


def _numbers(state: CoupledState) -> Float[np.ndarray, " _"]:
    """Return the states of both parts and the interface forces, the first numbers of a row."""
    parts = (*state.numerical.recorded(), *state.physical.recorded(), state.traction)
    return np.concatenate([np.ravel(x) for x in parts])


def run_over(coupled: Joined, base: Float[np.ndarray, " _"]) -> PartitionedHistories:
    """Run both parts over a record."""
    start, frame = coupled.start(base[0]), StepFrame.of(coupled)
    return frame.histories(
        np.stack([frame.start_of(start), *(frame.row_of(step) for step in steps_over(coupled, start, base))])
    )
