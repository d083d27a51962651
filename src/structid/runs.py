"""Runs of a model: design, records, histories and what became of each; a campaign leaves them, a surrogate is fitted to them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from structid.channels import standard_unit
from structid.errors import InputError, Status, check_choice
from structid.ground_motion.excitation import Excitation, padded_values
from structid.histories import Histories
from structid.probability.space import Design
from structid.reasons import general_reason
from structid.units import factor

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class Values(Protocol):
    """Histories that may lie on disk."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """(run, time, channel)."""
        ...

    def read(self, rows: np.ndarray) -> np.ndarray:
        """Bring some runs into memory.

        Parameters
        ----------
        rows : ndarray of int, shape (n,)
            Which.

        Returns
        -------
        ndarray, shape (n, time, channel)
            In SI.
        """
        ...


@dataclass(frozen=True, eq=False)
class InMemory:
    """Histories in memory, with the face of those on disk.

    Parameters
    ----------
    array : ndarray, shape (run, time, channel)
        In SI.
    """

    array: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        """(run, time, channel)."""
        runs, samples, channels = self.array.shape
        return runs, samples, channels

    def read(self, rows: np.ndarray) -> np.ndarray:
        """Return some runs; see `Values.read`.

        Parameters
        ----------
        rows : ndarray of int, shape (n,)
            Which.

        Returns
        -------
        ndarray, shape (n, time, channel)
            In SI.
        """
        return self.array[rows]


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of one model over a design, on one record or several; histories stay on disk until they are asked for.

    Parameters
    ----------
    design : Design
        The points, with their space.
    records : sequence of Excitation
        The records.
    channels : sequence of str
        Names of the channels.
    stored : Values
        The histories; NaN beyond a failure, beyond the end of a shorter record, and of a run that is pending.
    status : ndarray of int, shape (run,)
        A `Status` for each.
    record_of_run : ndarray of int, shape (run,), optional
        Which record drove it; the first when left out.
    reasons : sequence of str, optional
        Why it failed.
    failure_time, seconds : ndarray, shape (run,), optional
        Time of failure [s], wall time [s].
    attempts : ndarray of int, shape (run,), optional
        How often it was tried.
    finished : ndarray, shape (run,), optional
        When it ended, seconds of the epoch; NaN where that is not known.
    path : Path, optional
        The file they lie in, if they lie in one.
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
    def from_histories(cls, design: Design, histories: Histories, record: Excitation) -> Runs:
        """Put together what `Model.simulate` was given and what it returned.

        Parameters
        ----------
        design : Design
            The points.
        histories : Histories
            The responses.
        record : Excitation
            What drove them all.

        Returns
        -------
        Runs
            In memory.
        """
        return cls(
            design, (record,), histories.channels, InMemory(histories.values), histories.status,
            reasons=histories.reasons, failure_time=histories.failure_time,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.design)

    @property
    def done(self) -> np.ndarray:
        """Which runs reached their end, shape (run,)."""
        return self.status == Status.DONE

    @property
    def counts(self) -> dict[Status, int]:
        """How many runs ended how; every status is there."""
        return {status: int(np.count_nonzero(self.status == status)) for status in Status}

    @property
    def failures(self) -> list[tuple[str, int]]:
        """Reasons of failure, each with how many runs it stopped, the commonest first; numbers in them made alike."""
        return Counter(general_reason(r) for r in self.reasons if r).most_common()

    @property
    def rate(self) -> float:
        """Runs ended per second, over the last hundred of them; NaN if that is not known."""
        last = np.sort(self.finished[np.isfinite(self.finished)])[-100:]
        return float((len(last) - 1) / (last[-1] - last[0])) if len(last) > 1 and last[-1] > last[0] else float("nan")

    @property
    def values(self) -> np.ndarray:
        """All histories in memory, shape (run, time, channel)."""
        return self.stored.read(np.arange(len(self)))

    def channel(self, name: str) -> np.ndarray:
        """Bring one channel of every run into memory.

        Parameters
        ----------
        name : str
            The channel.

        Returns
        -------
        ndarray, shape (run, time)
            In SI.
        """
        return self.values[:, :, self.channels.index(check_choice("channel", name, self.channels))]

    def __getitem__(self, rows: Any) -> Runs:
        """Some of the runs, in the order asked for; nothing is read."""
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
        """These runs and then others of the same model, space and records, all in memory."""
        if self.channels != more.channels or [r.content_hash for r in self.records] != [
            r.content_hash for r in more.records
        ]:
            raise InputError("Runs + Runs", "runs with other channels or records", "runs of the same campaign")
        both: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(more, name)])
            for name in ("status", "record_of_run", "failure_time", "seconds", "attempts", "finished")
        }
        values = InMemory(np.concatenate([self.values, more.values]))
        design, reasons = self.design + more.design, self.reasons + more.reasons
        return replace(self, design=design, stored=values, reasons=reasons, path=None, **both)

    def on(self, record: int | str) -> Runs:
        """Return the runs driven by one record.

        Parameters
        ----------
        record : int or str
            Its place in `records`, or its name.

        Returns
        -------
        Runs
            Those runs, with that record alone.
        """
        names = [r.name for r in self.records]
        if isinstance(record, str) and record not in names:
            raise InputError("Runs.on", f"'{record}'", ", ".join(names))
        index = names.index(record) if isinstance(record, str) else record
        some = self[self.record_of_run == index]
        return replace(some, records=(self.records[index],), record_of_run=np.zeros(len(some), dtype=int))

    def batches(self, size: int = 256) -> Iterator[Runs]:
        """Go through the runs a batch at a time, so that memory does not grow with their number.

        Parameters
        ----------
        size : int
            Runs in a batch.

        Yields
        ------
        Runs
            The next ones.
        """
        for start in range(0, len(self), size):
            yield self[start : start + size]

    def histories(self) -> Histories:
        """Bring the histories into memory, those of one record or of records that are sampled alike.

        Returns
        -------
        Histories
            One row a run.

        Raises
        ------
        InputError
            If the records differ in step or length.
        """
        used = [self.records[i] for i in np.unique(self.record_of_run)] or list(self.records)
        if len({(r.dt, len(r)) for r in used}) > 1:
            raise InputError(
                "Runs.histories",
                "records of different steps or lengths",
                "runs on one record",
                "Choose with Runs.on(record).",
            )
        values = self.values[:, : len(used[0])]
        name = ", ".join(r.name for r in used)
        return Histories(values, used[0].dt, self.channels, self.status, self.failure_time, name, self.reasons)

    def to_xarray(self) -> xarray.Dataset:
        """Give everything as an xarray Dataset; runs in a file stay there until they are used.

        Returns
        -------
        xarray.Dataset
            Dimensions run, time, channel, parameter, record.
        """
        import xarray

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

    def plot(self, save: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the spread of the responses, and where in parameter space runs failed.

        Parameters
        ----------
        save : path-like, optional
            Where to save it, without ending: PNG and PDF are written.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.
        """
        from structid.figures import runs as figures

        done = np.flatnonzero(self.done)
        shown = self[done[np.linspace(0, len(done) - 1, min(len(done), figures.SHOWN)).astype(int)]]
        # Of several records the first that has runs: histories on different records have no common band.
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
        told = [f"{count} {status.words}" for status, count in self.counts.items() if count]
        lines.append("  " + ", ".join(told))
        lines += [f"  {count:6d} x {reason}" for reason, count in self.failures[:10]]
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class _Some:
    """Some rows of histories that may lie on disk."""

    whole: Values
    rows: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        return (len(self.rows), *self.whole.shape[1:])

    def read(self, rows: np.ndarray) -> np.ndarray:
        return self.whole.read(self.rows[rows])


def record_numbers(records: Sequence[Excitation], assignment: Any, runs: int) -> np.ndarray:
    """Say which record drives each run.

    Parameters
    ----------
    records : sequence of Excitation
        The records.
    assignment : None, "cycle", or sequence of int or str
        ``"cycle"`` deals the records out in turn; a sequence names one for each run.
    runs : int
        How many runs.

    Returns
    -------
    ndarray of int, shape (run,)
        Places in `records`.

    Raises
    ------
    InputError
        If there are several records and it is not said, or not for every run.
    """
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
            "assignment", f"{came} for {runs} runs on {len(records)} records", '"cycle", or a record for each run',
            "Say which record drives which run, by place or by name.",
        )  # fmt: skip
    numbers = np.empty(runs, dtype=int)
    for i, which in enumerate(assignment):
        known = which in names if isinstance(which, str) else 0 <= int(which) < len(records)
        if not known:
            raise InputError("assignment", f"{which!r} for run {i}", ", ".join(names))
        numbers[i] = names.index(which) if isinstance(which, str) else int(which)
    return numbers
