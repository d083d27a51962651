"""A hybrid test with two parts, a specimen and a record: feasibility check, run and result."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from structid.core.errors import InputError, StructidWarning
from structid.core.validation import check_arguments
from structid.ground_motion.record import GroundMotion
from structid.hybrid.control.compensation import Compensation
from structid.hybrid.control.motion import ITS_OWN_RAMP, Motion, continuous_motion, ramp_and_hold
from structid.hybrid.control.tracking import STIFFER, largest_secant
from structid.hybrid.control.transfer_system import Actuator
from structid.hybrid.coupling.base import CoarseStep, Coupling, Joined
from structid.hybrid.coupling.partitioned_run import StepFrame, base_of, steps_over
from structid.hybrid.coupling.prakash_hjelmstad import PrakashHjelmstad
from structid.hybrid.feasibility import Feasibility, HybridTestPlan, VirtualMoves, check_feasibility
from structid.hybrid.hybrid_result import Event, HybridResult
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.laboratory.specimen import Specimen, SpecimenDescription, SpecimenError
from structid.hybrid.laboratory.specimen_force import Move, SpecimenForce
from structid.hybrid.online.unscented_filter import UnscentedFilter
from structid.hybrid.recording.recorder import Recorder, RecordingError, journal_of, recorded, tails_of
from structid.hybrid.recording.result_file import About, save
from structid.hybrid.substructures.substructure import Substructure
from structid.mechanics.restoring_forces import CollapseError

NEVER_RESUMED = "A test on a structure is never resumed: a damaged structure cannot return to an earlier state."

INTERFACE_SHARE = 0.5
"""Fraction of the numerical part's interface mass that the physical part receives if `physical` is not given."""


@check_arguments
@dataclass(frozen=True, eq=False)
class HybridTest:
    """A pseudo-dynamic hybrid test with substructures.

    Parameters
    ----------
    numerical : Substructure
        Part of the structure that is computed.
    specimen : Specimen
        Specimen in the laboratory, or a program in its place.
    record : GroundMotion
        Ground acceleration that excites both parts.
    dt : float
        Coarse step Δt [s] of simulated time.
    time_scale : float
        λ, ratio of wall time to simulated time.
    coupling : Coupling, optional
        Default: `PrakashHjelmstad` without substeps. On the coarse step, the specimen moves by ramp and hold, or by its own
        ramp if it accepts one position per move. On the fine step λ Δt/ss, it moves continuously, in whole controller steps.
    compensation : Compensation, optional
        Compensation of the delay of the transfer system.
    physical : Substructure, optional
        Mass, damping, K₀ and influence of the specimen's part; its ``restoring_force`` is the expected force for the feasibility
        check. By default, the specimen's channels are the interface, its description gives the stiffness, and half of the
        numerical part's interface mass belongs to it.
    geometry : array-like, shape (channel, dof), optional
        Matrix B of the channel displacements B u; default: one channel per degree of freedom of the physical part.
    duration : float, optional
        Simulated part of the record [s]; default: the whole record.
    force_correction : bool
        Whether the force is corrected to r + K₀ (ũ − u_m). The correction is exact for a linear specimen. For a softened
        specimen, it adds the damping (K₀ − K_t) τ/λ.
    online : UnscentedFilter, optional
        Filter that estimates the parameters of a one-channel specimen during the test.

    Examples
    --------
    >>> import structid as si
    >>> from structid.hybrid.coupling.coupling_benchmark import LAW, two_floor_frame
    >>> upper, lower = si.cut_frame(two_floor_frame(hysteretic=True), 1)
    >>> record = si.GroundMotion.synthetic(seed=1).trim(2.0, 3.0).scale_to_pga(2.0)
    >>> test = si.HybridTest(upper, si.SimulatedSpecimen(lower.force), record, dt=0.01, time_scale=100.0, physical=lower)
    >>> test.check().can_work
    True
    >>> print(test.run())
    HybridResult: 100 of 100 steps, 1 s of simulated time, finished
    """

    numerical: Substructure
    specimen: Specimen
    record: GroundMotion
    dt: float
    time_scale: float
    coupling: Coupling = field(default_factory=PrakashHjelmstad)
    compensation: Compensation | None = None
    physical: Substructure | None = None
    geometry: np.ndarray | None = None
    duration: float | None = None
    force_correction: bool = False
    online: UnscentedFilter | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.time_scale) and self.time_scale > 0.0):
            raise InputError("HybridTest.time_scale", f"{self.time_scale!r}", "a positive number")
        if self.online is not None and len(self._description.channels) > 1:
            raise InputError(
                "HybridTest.online", f"a filter for {len(self._description.channels)} channels", "one channel"
            )
        if self.compensation is not None and self.compensation.learns and not self._motion.samples == 1:
            raise InputError(
                "HybridTest.compensation",
                f"a {type(self.compensation).__name__} with {self._motion.samples} controller steps per move",
                "substeps with one controller step each: the compensation learns from every controller step",
                f'Use substeps={round(self.time_scale * self.dt / self._description.controller_step)}, fine="physical".',
            )

    # --- parts and geometry -------------------------------------------------------------------------------------

    @cached_property
    def _description(self) -> SpecimenDescription:
        return self.specimen.describe()

    @cached_property
    def _parts(self) -> tuple[Substructure, Substructure]:
        """Numerical part and physical part."""
        if self.physical is not None:
            return self.numerical, self.physical
        stiffness_of_specimen, rows = self._description.stiffness, np.asarray(self.numerical.interface)
        if stiffness_of_specimen is None or len(stiffness_of_specimen) != len(rows):
            raise InputError(
                "HybridTest.physical",
                "it is missing",
                "a Substructure with mass, damping and K₀ of the specimen's part",
                "Omit it only if the specimen's description gives a stiffness and one channel for each row of the interface.",
            )
        shared = INTERFACE_SHARE * rows @ self.numerical.mass @ rows.T
        rest = replace(self.numerical, mass=self.numerical.mass - rows.T @ shared @ rows)
        return rest, Substructure(
            shared,
            0.0 * shared,
            np.array(stiffness_of_specimen),
            list(range(len(stiffness_of_specimen))),
            name=self._description.name,
        )

    @cached_property
    def _geometry(self) -> np.ndarray:
        """Matrix B, shape (channel, dof)."""
        channels, dofs = len(self._description.channels), self._parts[1].dofs
        if self.geometry is None and channels == dofs:
            return np.eye(dofs)
        given = None if self.geometry is None else np.asarray(self.geometry, dtype=np.float64)
        if given is None or given.shape != (channels, dofs):
            came = "it is missing" if given is None else f"an array of shape {given.shape}"
            raise InputError("HybridTest.geometry", came, f"shape ({channels}, {dofs}): channels, degrees of freedom")
        return given

    @cached_property
    def _motion(self) -> Motion:
        wall, step = self.time_scale * self.dt, self._description.controller_step
        if self.coupling.fine != "physical" and self._description.longest_path == 1:
            return ITS_OWN_RAMP
        if self.coupling.fine == "physical":
            return continuous_motion(wall / self.coupling.substeps, step)
        return ramp_and_hold(wall, step)

    def _joined(self, force: SpecimenForce) -> Joined:
        numerical, physical = self._parts
        return self.coupling.joined(numerical, replace(physical, restoring_force=force), self.dt)

    def _force(self, specimen: Specimen, moved: Callable[[Move], None] | None = None) -> SpecimenForce:
        step = self._description.controller_step
        begun = (
            None if self.compensation is None else self.compensation.begin(len(self._geometry), step, self.time_scale)
        )
        correction = self._parts[1].stiffness if self.force_correction else None
        return SpecimenForce(specimen, self._geometry, self._motion, begun, correction, moved)

    def _move_callback(self, moves: list[Move]) -> Callable[[Move], None]:
        """Return a function that stores every move and passes it to the filter."""
        online = self.online
        if online is None:
            return moves.append

        def store_and_filter(move: Move) -> None:
            moves.append(move)
            online.see(float(move.measured[0]), float(move.force[0]))

        return store_and_filter

    # --- check and run ------------------------------------------------------------------------------------------

    def check(self) -> Feasibility:
        """Check whether the test is feasible, from its parts and a virtual run; nothing moves.

        Returns
        -------
        Feasibility
            Key figures, reasons for a refusal, and warnings.

        Raises
        ------
        InputError
            If parts, record, geometry and steps are inconsistent.
        """
        return self._checked

    @cached_property
    def _checked(self) -> Feasibility:
        """Result of the check, computed once for the user and the run."""
        coupled = self._joined(self._force(self.specimen)).of_parts(*self._parts)
        base = base_of(self.record, coupled, self.duration)
        with np.errstate(over="ignore", invalid="ignore"):  # unbounded growth is refused later
            virtual = self._virtual_moves(coupled, base)
        plan = HybridTestPlan(
            coupled, self._description, self._geometry, self._motion, self.compensation, self.time_scale
        )
        return check_feasibility(plan, virtual, (len(base) - 1) // coupled.substeps)

    def _virtual_moves(self, coupled: Joined, base: np.ndarray) -> VirtualMoves:
        """Return the expected moves of the specimen, computed with the expected force.

        In continuous motion, a delay makes readings late and so changes later commands, with or without compensation.
        The virtual run then uses a simulated specimen behind a transfer system with the same delays.
        """
        channels, geometry = self._description.channels, self._geometry
        late = self._motion.continuous and any(channel.delay for channel in channels)
        if not (late and np.array_equal(geometry, np.eye(len(channels)))):
            steps, collapse = _taken_virtually(coupled, base)
            imposed_moves = _imposed(coupled, steps)
            return VirtualMoves(imposed_moves[0] @ geometry.T, imposed_moves[1] @ np.linalg.pinv(geometry), collapse)
        specimen = SimulatedSpecimen(
            self._parts[1].force,
            [Actuator(delay=channel.delay) for channel in channels],
            channels=[channel.name for channel in channels],
            units=[channel.unit for channel in channels],
            controller_step=self._description.controller_step,
        )
        moves: list[Move] = []
        _, collapse = _taken_virtually(self._joined(self._force(specimen, moves.append)), base)
        return VirtualMoves(np.stack([m.target for m in moves]), np.stack([m.force for m in moves]), collapse)

    def run(self, store: str | os.PathLike[str] | None = None, *, resume: bool = False) -> HybridResult:
        """Run the test.

        If the test ends early (a refused move, a silent specimen, a full disk, Ctrl-C), the specimen holds its position. The
        result and the store then contain every finished step.

        Parameters
        ----------
        store : path-like, optional
            HDF5 file for the result. During the test, its recording is next to this file; `open_hybrid` reads the recording too.
        resume : bool
            Whether to continue an interrupted simulated test. A new specimen repeats all recorded steps; the results
            must be bit-identical.

        Returns
        -------
        HybridResult
            Result of the test.

        Raises
        ------
        InputError
            If the test is infeasible, if the store exists, or if a test on a structure is to be resumed. In these cases, nothing
            has moved.
        """
        checked = self.check()
        if not checked.can_work:
            raise InputError(
                "HybridTest",
                " ".join(checked.refusals).removesuffix("."),
                "a feasible test",
                "Print HybridTest.check() for all figures.",
            )
        return self._run_unchecked(checked, None if store is None else Path(store), resume)

    def _run_unchecked(
        self, checked: Feasibility | None = None, store: Path | None = None, resume: bool = False
    ) -> HybridResult:
        """Run a test even if it is infeasible; this is safe for simulated specimens only."""
        checked = self.check() if checked is None else checked
        moves: list[Move] = []
        if self.online is not None:
            self.online.begin(0.0 if self._description.datum is None else self._description.datum[0])
        coupled = self._joined(self._force(self.specimen, self._move_callback(moves)))
        about = About(
            self._description,
            checked,
            self.record,
            StepFrame.of(coupled),
            coupled.substeps if coupled.fine_is_physical else 1,
        )
        earlier = self._earlier(store) if resume and store is not None else None
        recorder = None if store is None else Recorder(store, about.to_plain(), about.width)
        rows, events = self._taken(coupled, about, moves, recorder, earlier)
        result = about.result(rows, events)
        back = np.linalg.pinv(self._geometry)
        moves_of_result = result.moves
        stiffer = largest_secant(
            moves_of_result.measured,
            moves_of_result.target,
            moves_of_result.force,
            back.T @ self._parts[1].stiffness @ back,
        )
        if stiffer > STIFFER:
            warning = (
                f"The specimen was {stiffer:.3g} times as stiff as K₀. K₀ must be the largest tangent stiffness; "
                "otherwise steps may be unstable."
            )
            warnings.warn(warning, StructidWarning, stacklevel=4)
            events.insert(0, Event(result.steps * self.dt, warning))  # the event that ended the test is the last one
        path = None if self.online is None else self.online.path()
        result = replace(result, events=tuple(events), stiffness_ratio=stiffer, online=path)
        if recorder is not None and store is not None:
            result = _stored(result, recorder, store)
        return result

    def _taken(
        self, coupled: Joined, about: About, moves: list[Move], recorder: Recorder | None, earlier: np.ndarray | None
    ) -> tuple[np.ndarray, list[Event]]:
        """Take all steps; return the rows of the completed steps, and the event that ended the test early."""
        base = base_of(self.record, coupled, self.duration)
        rows: list[np.ndarray] = []
        recorded_moves = 0

        def keep(step: np.ndarray) -> None:
            nonlocal recorded_moves
            rows.append(about.row(step, moves[recorded_moves:]))
            recorded_moves = len(moves)
            number = len(rows) - 1
            if earlier is not None and number < len(earlier) and not np.array_equal(rows[-1], earlier[number], True):
                came = f"step {number} differs from the recording"
                raise InputError("HybridTest.run", came, "the recorded test, with the specimen in its initial state")
            if recorder is not None:
                recorder.add(rows[-1])

        try:
            start = coupled.start(base[0])
            keep(about.frame.start_of(start))
            for step in steps_over(coupled, start, base):
                keep(about.frame.row_of(step))
            return np.stack(rows), []
        except (SpecimenError, RecordingError) as error:
            ending = str(error)
        except KeyboardInterrupt:
            ending = "The test was stopped from the keyboard."
        self.specimen.hold(ending)
        return np.reshape(rows, (len(rows), about.width)), [Event(max(len(rows) - 1, 0) * self.dt, ending)]

    def _earlier(self, store: Path) -> np.ndarray | None:
        """Return the rows of an interrupted simulated test, and add .before to the file names of its recording."""
        if not journal_of(store).exists():
            return None
        if not self._description.simulated:
            raise InputError(
                "HybridTest.run",
                f"an interrupted test on '{self._description.name}'",
                "a simulated specimen",
                NEVER_RESUMED,
            )
        rows = recorded(store)[1]
        for path in (journal_of(store), *tails_of(store)):
            path.replace(path.with_name(path.name + ".before"))
        return rows


def _stored(result: HybridResult, recorder: Recorder, store: Path) -> HybridResult:
    """Write a result to its store and remove the recording; if the disk fails, keep the recording."""
    recorder.close()
    try:
        save(result, store)
    except OSError as error:
        warning = f"{store} could not be written: {error.strerror or error}. open_hybrid reads its recording instead."
        return replace(
            result, events=(Event(float(result.coarse.time[-1]) if result.histories else 0.0, warning), *result.events)
        )
    recorder.remove()
    for path in (journal_of(store), *tails_of(store)):
        path.with_name(path.name + ".before").unlink(missing_ok=True)
    return result


def _taken_virtually(coupled: Joined, base: np.ndarray) -> tuple[list[CoarseStep], str]:
    """Return the steps of a virtual run and the reason for its failure, an empty string if it did not fail."""
    steps: list[CoarseStep] = []
    try:
        for step in steps_over(coupled, coupled.start(base[0]), base):
            steps.append(step)
    except (CollapseError, SpecimenError) as collapse:
        return steps, f"In the virtual run, the specimen fails at {len(steps) * coupled.dt:.3g} s: {collapse}."
    return steps, ""


def _imposed(coupled: Joined, steps: list[CoarseStep]) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacements imposed on the physical part, and its forces, shape (move, dof)."""
    if coupled.fine_is_physical:
        parts = [step.fine.part for step in steps]
        return np.concatenate([p.imposed for p in parts]), np.concatenate([p.reading for p in parts])
    states = [step.state.physical for step in steps]
    return np.stack([s.imposed for s in states]), np.stack([s.reading for s in states])
