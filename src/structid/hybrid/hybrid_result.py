"""Result of a hybrid test: histories at coarse and fine steps, moves of the specimen, events, tracking."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from structid.core.errors import InputError, check_choice
from structid.core.notebook import ShownAsText
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import CombinedExcitation, DisplacementHistory, RotationHistory
from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.tracking import (
    FrequencyEvaluationIndex,
    energy_error,
    frequency_evaluation_index,
    root_mean_square_error,
    tracking_indicator,
)
from structid.hybrid.coupling.partitioned_run import CoarseHistory, PartitionedHistories
from structid.hybrid.feasibility import Feasibility
from structid.hybrid.laboratory.specimen import SpecimenDescription
from structid.hybrid.online.unscented_filter import FilteredPath
from structid.models.hysteretic.imposed_displacements import force_channels
from structid.observation import Observation

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Event(NamedTuple):
    """An event of a test."""

    time: float  # simulated time [s]
    what: str  # description


@dataclass(frozen=True, eq=False)
class MoveHistory:
    """All moves of the specimen, in order; arrays (move, channel). The first move, before the test, is to zero."""

    time: Float[np.ndarray, " move"]  # simulated time at the end of the move [s]
    target: np.ndarray  # target displacement [m]
    command: np.ndarray  # commanded displacement [m]
    measured: np.ndarray  # measured displacement [m]
    force: np.ndarray  # force of the specimen [N]

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, eq=False)
class Tracking:
    """Tracking indicators of one channel."""

    error: float  # RMS (u_m − u_c)/RMS u_c
    index: FrequencyEvaluationIndex | None  # amplitude and delay; None if no movement was commanded
    # Area in the synchronisation subspace [m²]; it grows while the channel lags
    indicator: Float[np.ndarray, " move"] = field(repr=False)
    energy: Float[np.ndarray, " move"] = field(repr=False)  # energy error [J]; positive if it feeds the structure


@dataclass(frozen=True, eq=False)
class HybridResult(ShownAsText):
    """Result of a finished or interrupted hybrid test.

    Parameters
    ----------
    histories : PartitionedHistories or None
        Histories of both parts for the finished steps; None if the test ended before its initial state was recorded.
    moves : MoveHistory
        Moves of the specimen.
    events : tuple of Event
        Events of the test; if it ended early, the last event is the reason.
    feasibility : Feasibility
        Result of the check before the test.
    description : SpecimenDescription
        Description of the specimen.
    record : GroundMotion
        Ground acceleration of the test.
    stiffness_ratio : float
        Largest measured secant stiffness, relative to K₀; NaN if nothing moved.
    online : FilteredPath or None
        Estimates of the online filter during the test; None without a filter.

    Examples
    --------
    >>> import structid as si
    >>> result = si.open_hybrid("hybrid.h5")  # doctest: +SKIP
    >>> result.moves.measured.max()  # doctest: +SKIP
    """

    histories: PartitionedHistories | None
    moves: MoveHistory
    events: tuple[Event, ...]
    feasibility: Feasibility
    description: SpecimenDescription
    record: GroundMotion
    stiffness_ratio: float
    online: FilteredPath | None = None

    @property
    def steps(self) -> int:
        """Number of completed coarse steps."""
        return 0 if self.histories is None else len(self.histories.coarse.time) - 1

    @property
    def finished(self) -> bool:
        """True if the test reached the end of the record."""
        return self.steps == self.feasibility.steps

    @property
    def coarse(self) -> CoarseHistory:
        """Histories at the coarse steps."""
        if self.histories is None:
            raise InputError(
                "HybridResult", "the test ended before its initial state was recorded", "a test with histories"
            )
        return self.histories.coarse

    @cached_property
    def tracking(self) -> dict[str, Tracking]:
        """Tracking indicators of each channel, by name."""
        tracking = {}
        for k, channel in enumerate(self.description.channels):
            target, measured = self.moves.target[:, k], self.moves.measured[:, k]
            step = float(self.moves.time[1]) if len(self.moves) > 1 else 1.0
            index = frequency_evaluation_index(target, measured, step) if np.any(target) else None
            tracking[channel.name] = Tracking(
                root_mean_square_error(target, measured) if len(target) else np.nan,
                index,
                tracking_indicator(target, measured),
                energy_error(self.moves.force[:, k], target, measured),
            )
        return tracking

    @property
    def datum(self) -> np.ndarray:
        """Zero position of the channels, relative to the position before the first test, shape (channel,)."""
        datum = self.description.datum
        return np.zeros(len(self.description.channels)) if datum is None else np.array(datum)

    @check_arguments
    def observation(
        self,
        channels: Sequence[str] = (),
        *,
        before: Sequence[HybridResult] = (),
        sd: float | Sequence[float] | np.ndarray | None = None,
    ) -> Observation:
        """Return an observation of the specimen: forces at its measured displacements, not at the commanded ones.

        The response of a specimen depends on its earlier tests. The moves of the tests in `before` come first.
        Displacements are relative to the zero of the first test. After a test, the path goes straight to the zero of
        the next test, where the force was zero.

        Parameters
        ----------
        channels : sequence of str, optional
            Names of the forces, one per channel. Default: ``"restoring_force"`` for one channel, ``"restoring_force_1"``, … for
            several channels; ``"moment_3"`` if the third channel is a rotation.
        before : sequence of HybridResult
            Earlier tests on the same specimen, in order of time.
        sd : float or sequence of float, optional
            Known standard deviation of the forces [N, N·m]: one value for all channels, or one value per channel.

        Returns
        -------
        Observation
            Response to a `DisplacementHistory`, or to several in a `CombinedExcitation`; every move is a sample.

        Raises
        ------
        InputError
            If a test has no moves or belongs to another specimen, or if `sd` has a wrong number of values.
        """
        tests = (*before, self)
        for test in tests:
            if len(test.moves) < 2 or test.description.channels[0].name != self.description.channels[0].name:
                came = f"a test on '{test.description.name}' with {len(test.moves)} moves"
                raise InputError("HybridResult.observation", came, "tests with moves, all on the same specimen")
        displacements = np.concatenate([test.datum + test.moves.measured for test in tests])
        forces = np.concatenate([test.moves.force for test in tests])
        step = float(self.moves.time[1])
        name = self.record.name if len(tests) == 1 else f"{len(tests)} tests up to {self.record.name}"
        units = [channel.unit for channel in self.description.channels]
        imposed = [
            (RotationHistory if unit == "rad" else DisplacementHistory)(column, step, f"moves of {name}")
            for unit, column in zip(units, displacements.T, strict=True)
        ]
        excitation = imposed[0] if len(imposed) == 1 else CombinedExcitation(imposed, f"moves of {name}")
        names = tuple(channels) or force_channels(units)
        sds = None if sd is None else np.tile(_for_each(sd, names), (len(forces), 1))
        return Observation(excitation, forces, names, name=name, sd=sds)

    def plot(self, channel: str | None = None, save: str | os.PathLike[str] | None = None) -> Figure:
        """Plot the tracking of an actuator, and the hysteresis loop of its channel.

        Parameters
        ----------
        channel : str, optional
            Name of the channel; default: the first channel.
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        Figure
            Figure with the loop, the synchronisation subspace, and the tracking and energy errors over time.
        """
        from structid.figures import hybrid as figure

        names = [channel_description.name for channel_description in self.description.channels]
        k = 0 if channel is None else names.index(check_choice("HybridResult.plot", channel, names))
        turns, result, moves = self.description.channels[k].unit == "rad", self.tracking[names[k]], self.moves
        loop = (names[k], 1e3 * moves.measured[:, k], 1e-3 * moves.force[:, k])
        plane = (names[k], 1e3 * moves.target[:, k], 1e3 * moves.measured[:, k])
        units = ("mrad", "kN m") if turns else ("mm", "kN")
        return figure.loop_and_tracking(
            loop, plane, moves.time, 1e6 * result.indicator, result.energy, units, save=save
        )

    def __str__(self) -> str:
        time = 0.0 if self.histories is None else self.histories.coarse.time[-1]
        ended = "finished" if self.finished else (self.events[-1].what if self.events else "ended")
        return f"HybridResult: {self.steps} of {self.feasibility.steps} steps, {time:g} s of simulated time, {ended}"


def _for_each(sd: float | Sequence[float] | np.ndarray, channels: Sequence[str]) -> np.ndarray:
    """A standard deviation for each channel."""
    sds = np.atleast_1d(np.asarray(sd, dtype=np.float64))
    if sds.shape not in ((1,), (len(channels),)) or not (np.isfinite(sds) & (sds > 0.0)).all():
        allowed = f"one positive number for all forces, or one for each of {', '.join(channels)}"
        raise InputError("HybridResult.observation: sd", f"{sd!r}", allowed)
    return np.asarray(np.broadcast_to(sds, (len(channels),)))
