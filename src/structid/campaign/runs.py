"""Model runs: design, records, histories and status. A campaign produces the runs; a surrogate is fitted to them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from jaxtyping import Float, Int

from structid.core.channels import standard_unit
from structid.core.errors import InputError, Status, check_choice
from structid.core.notebook import ShownAsText
from structid.core.reasons import counted_reasons, grouped_reasons
from structid.core.units import factor
from structid.core.validation import check_arguments
from structid.figures import runs as figures
from structid.ground_motion.excitation import Excitation, padded_values
from structid.histories import Histories
from structid.probability.designs import Design

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class Values(Protocol):
    """Histories in memory or on disk."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """(run, time, channel)."""
        ...

    def read(self, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n time channel"]:
        """Read the histories of selected runs into memory."""
        ...


@dataclass(frozen=True, eq=False)
class StoredInMemory:
    """Histories in memory, with the same interface as histories on disk."""

    array: Float[np.ndarray, "run time channel"]  # Histories in SI

    @property
    def shape(self) -> tuple[int, int, int]:
        """(run, time, channel)."""
        runs, samples, channels = self.array.shape
        return runs, samples, channels

    def read(self, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n time channel"]:
        """Return the histories of selected runs; see `Values.read`."""
        histories: np.ndarray = self.array[rows]
        return histories


@dataclass(frozen=True, eq=False)
class Runs(ShownAsText):
    """Runs of one model at the points of a design, on one or several records. Histories stay on disk until needed.

    Parameters
    ----------
    design : Design
        The points and their space.
    records : sequence of Excitation
        The records.
    channels : sequence of str
        Names of the channels.
    stored : Values
        The histories; NaN after a failure, after the end of a shorter record, and for a pending run.
    status : ndarray of int, shape (run,)
        The `Status` of each run.
    record_of_run : ndarray of int, shape (run,), optional
        Number of the record of each run; the first record by default.
    reasons : sequence of str, optional
        Reason why each run failed.
    failure_time, seconds : ndarray, shape (run,), optional
        Time of failure [s], wall time [s].
    attempts : ndarray of int, shape (run,), optional
        Number of attempts of each run.
    finished : ndarray, shape (run,), optional
        End time of each run, in seconds since the epoch; NaN if unknown.
    path : Path, optional
        The file of the runs, if all are in one file.

    Examples
    --------
    >>> import structid as si
    >>> space = si.ParameterSpace(stiffness=si.Uniform(6.0, 9.0, unit="kN/mm"))
    >>> model = si.BoucWen(mass=12e3, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma=63.0, free=space.names)
    >>> runs = si.Campaign(model, si.GroundMotion.synthetic(seed=7), space.sample(4, seed=1)).run()
    >>> runs.channels
    ('velocity',)
    """

    design: Design
    records: tuple[Excitation, ...]
    channels: tuple[str, ...]
    stored: Values
    status: np.ndarray
    record_of_run: np.ndarray = field(default=None)  # type: ignore[arg-type]
    reasons: tuple[str, ...] = ()
    failure_time: np.ndarray = field(default=None)  # type: ignore[arg-type]
    seconds: np.ndarray = field(default=None)  # type: ignore[arg-type]
    attempts: np.ndarray = field(default=None)  # type: ignore[arg-type]
    finished: np.ndarray = field(default=None)  # type: ignore[arg-type]
    path: Path | None = None

    def __post_init__(self) -> None:
        runs = len(self.design)
        if self.stored.shape[0] != runs or self.stored.shape[2] != len(self.channels):
            raise InputError(
                "Runs", f"histories of shape {self.stored.shape}", f"({runs} runs, time, {len(self.channels)} channels)"
            )
        defaults = {
            "record_of_run": np.zeros(runs, dtype=int),
            "failure_time": np.full(runs, np.nan),
            "seconds": np.full(runs, np.nan),
            "attempts": np.ones(runs, dtype=int),
            "finished": np.full(runs, np.nan),
        }
        for name, default in defaults.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, default)
        object.__setattr__(self, "status", np.asarray(self.status, dtype=np.int8))
        object.__setattr__(self, "reasons", tuple(self.reasons) or ("",) * runs)

    @classmethod
    @check_arguments
    def from_histories(cls, design: Design, histories: Histories, record: Excitation) -> Runs:
        """Combine the arguments of `Model.simulate` with its result.

        Parameters
        ----------
        design : Design
            The points.
        histories : Histories
            The responses.
        record : Excitation
            The record of all runs.

        Returns
        -------
        Runs
            The runs, in memory.
        """
        return cls(
            design,
            (record,),
            histories.channels,
            StoredInMemory(histories.values),
            histories.status,
            reasons=histories.reasons,
            failure_time=histories.failure_time,
        )

    def __len__(self) -> int:
        return len(self.design)

    @property
    def done(self) -> np.ndarray:
        """Whether each run reached its end, shape (run,)."""
        done: np.ndarray = self.status == Status.DONE
        return done

    @property
    def counts(self) -> dict[Status, int]:
        """Number of runs with each status, including zero counts."""
        return {status: int(np.count_nonzero(self.status == status)) for status in Status}

    @property
    def failures(self) -> list[tuple[str, int]]:
        """Reasons of failure with the number of runs, most frequent first; reasons that differ only in numbers count as one."""
        return grouped_reasons(self.reasons)

    @property
    def rate(self) -> float:
        """Runs completed per second, averaged over the last hundred runs; NaN if unknown."""
        last = np.sort(self.finished[np.isfinite(self.finished)])[-100:]
        return float((len(last) - 1) / (last[-1] - last[0])) if len(last) > 1 and last[-1] > last[0] else float("nan")

    @property
    def values(self) -> np.ndarray:
        """All histories in memory, shape (run, time, channel)."""
        return self.stored.read(np.arange(len(self)))

    def channel(self, name: str) -> np.ndarray:
        """Read one channel of every run into memory.

        Parameters
        ----------
        name : str
            Name of the channel.

        Returns
        -------
        ndarray, shape (run, time)
            Histories in SI.
        """
        histories: np.ndarray = self.values[:, :, self.channels.index(check_choice("channel", name, self.channels))]
        return histories

    def __getitem__(self, rows: Any) -> Runs:
        """Select runs in the given order; no history is read."""
        index = np.atleast_1d(np.arange(len(self))[rows])
        return replace(
            self,
            design=self.design[index],
            stored=_Some(self.stored, index),
            status=self.status[index],
            record_of_run=self.record_of_run[index],
            reasons=tuple(self.reasons[i] for i in index),
            failure_time=self.failure_time[index],
            seconds=self.seconds[index],
            attempts=self.attempts[index],
            finished=self.finished[index],
            path=None,
        )

    def __add__(self, more: Runs) -> Runs:
        """Append other runs of the same model, space and records; the result is in memory."""
        if self.channels != more.channels or [r.content_hash for r in self.records] != [
            r.content_hash for r in more.records
        ]:
            raise InputError("Runs + Runs", "runs with other channels or records", "runs of the same campaign")
        both: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(more, name)])
            for name in ("status", "record_of_run", "failure_time", "seconds", "attempts", "finished")
        }
        values = StoredInMemory(np.concatenate([self.values, more.values]))
        design, reasons = self.design + more.design, self.reasons + more.reasons
        return replace(self, design=design, stored=values, reasons=reasons, path=None, **both)

    def on(self, record: int | str) -> Runs:
        """Return the runs driven by one record.

        Parameters
        ----------
        record : int or str
            Index of the record in `records`, or its name.

        Returns
        -------
        Runs
            Runs on this record only.
        """
        names = [r.name for r in self.records]
        if isinstance(record, str) and record not in names:
            raise InputError("Runs.on", f"'{record}'", ", ".join(names))
        index = names.index(record) if isinstance(record, str) else record
        some = self[self.record_of_run == index]
        return replace(some, records=(self.records[index],), record_of_run=np.zeros(len(some), dtype=int))

    def batches(self, size: int = 256) -> Iterator[Runs]:
        """Iterate over batches of runs, so that memory use does not grow with the number of runs.

        Parameters
        ----------
        size : int
            Number of runs in a batch.

        Yields
        ------
        Runs
            The next batch.
        """
        for start in range(0, len(self), size):
            yield self[start : start + size]

    def histories(self) -> Histories:
        """Read the histories into memory; all records must have the same time step and length.

        Returns
        -------
        Histories
            One row for each run.

        Raises
        ------
        InputError
            If the records differ in time step or length.
        """
        used = [self.records[i] for i in np.unique(self.record_of_run)] or list(self.records)
        if len({(r.dt, len(r)) for r in used}) > 1:
            raise InputError(
                "Runs.histories",
                "records with different time steps or lengths",
                "runs on one record",
                "Choose a record with Runs.on(record).",
            )
        values = self.values[:, : len(used[0])]
        name = ", ".join(r.name for r in used)
        return Histories(values, used[0].dt, self.channels, self.status, self.failure_time, name, self.reasons)

    def to_xarray(self) -> xarray.Dataset:
        """Return all data of the runs as an xarray Dataset; histories in a file are read when needed.

        Returns
        -------
        xarray.Dataset
            Dimensions run, time, channel, parameter, record.
        """
        import xarray  # slow to import

        if self.path is not None:
            return xarray.open_dataset(self.path, engine="h5netcdf")
        excitation = padded_values(self.records)
        return xarray.Dataset(
            {
                "values": (("run", "time", "channel"), self.values),
                "theta": (("run", "parameter"), self.design.values),
                "status": ("run", self.status),
                "reason": ("run", np.array(self.reasons, dtype=object)),
                "failure_time": ("run", self.failure_time),
                "seconds": ("run", self.seconds),
                "attempts": ("run", self.attempts),
                "record_of_run": ("run", self.record_of_run),
                "excitation": (("record", "time", "part")[: excitation.ndim], excitation),
                "dt": ("record", [r.dt for r in self.records]),
                "samples": ("record", [len(r) for r in self.records]),
            },
            coords={
                "channel": list(self.channels),
                "parameter": list(self.design.names),
                "record": [r.name for r in self.records],
            },
        )

    @check_arguments
    def plot(self, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw bands of the responses, and the failed runs in parameter space.

        Parameters
        ----------
        save : path-like, optional
            File name without extension; a PNG and a PDF are written.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        done = np.flatnonzero(self.done)
        shown = self[done[np.linspace(0, len(done) - 1, min(len(done), figures.SHOWN)).astype(int)]]
        # Draw only the first record that has runs: histories on different records have no common band.
        numbers = np.unique(shown.record_of_run)
        shown = shown.on(int(numbers[0])) if len(numbers) else shown
        record = shown.records[0]
        units = tuple(standard_unit(c).display for c in self.channels)
        return figures.overview(
            record.time,
            shown.values[:, : len(record)] / np.array([factor(u) for u in units]),
            self.channels,
            units,
            self.design.values / self.design.space.factors,
            self.design.names,
            tuple(self.design.space.units.values()),
            self.status,
            {int(s): s.words for s in Status},
            save=save,
        )

    def __str__(self) -> str:
        lines = [
            f"{len(self)} runs on {len(self.records)} record{'s' if len(self.records) > 1 else ''}, "
            f"{self.stored.shape[1]} samples of {', '.join(self.channels)}"
        ]
        counts = [f"{count} {status.words}" for status, count in self.counts.items() if count]
        lines.append("  " + ", ".join(counts))
        return "\n".join([*lines, *counted_reasons(self.failures)])


@dataclass(frozen=True, eq=False)
class _Some:
    """Selected rows of histories in memory or on disk."""

    whole: Values
    rows: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        return (len(self.rows), *self.whole.shape[1:])

    def read(self, rows: np.ndarray) -> np.ndarray:
        return self.whole.read(self.rows[rows])


def record_numbers(records: Sequence[Excitation], assignment: Any, runs: int) -> Int[np.ndarray, " run"]:
    """Index of the record that drives each run."""
    if assignment is None and len(records) == 1:
        return np.zeros(runs, dtype=int)
    if isinstance(assignment, str) and assignment == "cycle":
        return np.arange(runs) % len(records)
    names = [r.name for r in records]
    if assignment is None or isinstance(assignment, str) or len(assignment) != runs:
        came = (
            "nothing"
            if assignment is None
            else repr(assignment)
            if isinstance(assignment, str)
            else f"{len(assignment)}"
        )
        raise InputError(
            "assignment",
            f"{came} for {runs} runs on {len(records)} records",
            '"cycle", or one record for each run',
            "Give the record of each run, by number or by name.",
        )
    numbers = np.empty(runs, dtype=int)
    for i, which in enumerate(assignment):
        valid = which in names if isinstance(which, str) else 0 <= int(which) < len(records)
        if not valid:
            raise InputError("assignment", f"{which!r} for run {i}", ", ".join(names))
        numbers[i] = names.index(which) if isinstance(which, str) else int(which)
    return numbers
