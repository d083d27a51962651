"""A campaign: the model runs of a design on any executor. Each run is stored before the next result is awaited."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from structid.campaign.executors import LostWorkerError, Pool, opened
from structid.campaign.journal_entries import Finished
from structid.campaign.run_file import Header
from structid.campaign.runs import Runs, record_numbers
from structid.campaign.store import MemoryStore, RunStore, open_runs, stored_identity
from structid.core.errors import CampaignStoppedError, InputError, Status, StoreMismatchError
from structid.core.hashing import digest
from structid.core.journal import compare_identity
from structid.core.validation import check_arguments
from structid.engine.lanes.machine import engine
from structid.ground_motion.excitation import Excitation, check_signals_alike
from structid.models.base import Model
from structid.models.external.external import as_guarded
from structid.models.external.guard import PackedCall, attempt, packed
from structid.models.external.protocol import Outcome
from structid.probability.designs import Design

CampaignProgress = Callable[[int, int, int], None]
"""Callback whose arguments are the numbers of finished runs, of all runs, and of failed runs."""

BATCH = 256
"""Number of runs of a built-in model that are computed and stored together."""

TRIED_AGAIN = (Status.FAILED, Status.TIMED_OUT)
"""Statuses for which another attempt may succeed; a run that diverged would diverge again."""

RETRIED = (*TRIED_AGAIN, Status.DIVERGED)
"""Statuses of the runs that are repeated on request, because the solver may have changed."""


@dataclass(frozen=True)
class _Ticket:
    """A run to be carried out: its row in the design, and the number of the attempt."""

    row: int
    attempts: int


@check_arguments
class Campaign:
    """Runs of a model at the points of a design, on one or several records.

    Every finished run is on disk before the next result is awaited. If a campaign stops for any reason, run it again and it
    continues. Points that are appended to the design later are added to the store.

    Parameters
    ----------
    model : Model
        A built-in or external model.
    records : Excitation or sequence of Excitation
        The records that drive the model.
    design : Design
        The points.
    store : path-like, optional
        The HDF5 file to write. Without a file, the runs are kept in memory and lost when the process ends.
    assignment : "cycle" or sequence of int or str, optional
        With several records: the record of each run, by number or name; ``"cycle"`` takes the records in turn.

    Examples
    --------
    >>> import structid as si
    >>> space = si.ParameterSpace(stiffness=si.Uniform(6.0, 9.0, unit="kN/mm"))
    >>> model = si.BoucWen(mass=12e3, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma=63.0, free=space.names)
    >>> runs = si.Campaign(model, si.GroundMotion.synthetic(seed=7), space.sample(8, seed=1)).run()
    >>> runs.done.all()
    np.True_
    """

    def __init__(
        self,
        model: Model,
        records: Excitation | Sequence[Excitation],
        design: Design,
        store: str | os.PathLike[str] | None = None,
        assignment: Any = None,
    ) -> None:
        if not isinstance(design, Design):
            raise InputError(
                "Campaign.design",
                f"a {type(design).__name__}",
                "a Design",
                "Draw a design with space.sample(…), or make one with Design(points, space).",
            )
        if len(design) == 0:
            raise InputError("Campaign.design", "no points", "one or more points")
        self.records = (records,) if isinstance(records, Excitation) else tuple(records)
        if not self.records or not all(isinstance(r, Excitation) for r in self.records):
            raise InputError("Campaign.records", f"{records!r}", "a GroundMotion, ForceHistory, …, or a list of them")
        check_signals_alike("Campaign.records", self.records)
        self.model, self.design, self.store = model, design, store
        self.theta = model.parameters(design)
        self.record_of_run = record_numbers(self.records, assignment, len(design))
        hashes = [r.content_hash for r in self.records]
        self.keys = _keys(design.values, [hashes[i] for i in self.record_of_run])

    @property
    def identity(self) -> dict[str, Any]:
        """All data on which the runs depend, except the points: model, space, records, channels."""
        return {
            "model": self.model.content_hash,
            "space": self.design.space.content_hash,
            "records": [r.content_hash for r in self.records],
            "channels": list(self.model.channels),
            **({"engine": engine()} if self.model.batched else {}),
        }

    def refuse_another(self) -> None:
        """Check that any stored runs belong to this model, engine, records and space.

        Raises
        ------
        StoreMismatchError
            If the stored runs belong to another study.
        """
        stored = None if self.store is None else stored_identity(self.store)
        if self.store is not None and stored is not None:
            compare_identity(Path(self.store), stored, self.identity)

    def adopt(self) -> None:
        """Adopt the stored runs of another model version or another engine, without new model runs.

        Raises
        ------
        StoreMismatchError
            If the store differs in any other property.
        """
        if self.store is not None:
            RunStore(self.store, self._header, adopt=True).close()

    @property
    def _header(self) -> Header:
        return Header(self.identity, self.design.space, self.records, self.model.channels)

    def run(
        self,
        executor: Any = None,
        *,
        retry: bool = False,
        attempts: int = 1,
        adopt: bool = False,
        progress: CampaignProgress | None = None,
    ) -> Runs:
        """Carry out every run that is not stored yet.

        Parameters
        ----------
        executor : None, str, concurrent.futures.Executor or distributed.Client
            ``"serial"`` (the default), ``"processes"``, ``"processes:4"``, the address of a Dask scheduler (``"tcp://…"``), or
            an executor object. Built-in models run in batches on this machine and need no executor.
        retry : bool
            Repeat the stored runs that failed, timed out or diverged.
        attempts : int
            Maximum number of attempts for a run that fails or times out, including stored earlier attempts.
        adopt : bool
            Keep the stored runs of another version of the model; without `adopt` such runs are an error. This is useful, for
            example, after a bug fix in a solver that does not affect the finished runs.
        progress : callable, optional
            Callback whose arguments are the numbers of finished runs, of all runs, and of failed runs.

        Returns
        -------
        Runs
            The runs, in the order of the design.

        Raises
        ------
        StoreMismatchError
            If the store belongs to another model, record or space, or contains points that are not in this design.
        CampaignStoppedError
            If the executor failed; finished runs are stored.
        KeyboardInterrupt
            On Ctrl-C; the message explains how to continue.
        """
        if attempts < 1:
            raise InputError("Campaign.run: attempts", f"{attempts}", "a whole number of 1 or more")
        store = MemoryStore(self._header) if self.store is None else RunStore(self.store, self._header, adopt)
        try:
            todo = self._todo(store, retry, attempts)
            if not todo and self._is_part_of(store):
                return self._selected()
            self._check_points(store)
            if todo:
                store.describe(self.keys, self.design.values, self.record_of_run)
                count = _Counter(store, self.keys, todo, progress)
                if self.model.guarded:
                    self._one_by_one(store, todo, count, executor, attempts, retry)
                else:
                    self._in_batches(store, todo, count)
            return store.finish(self.keys, self.design.values, self.record_of_run)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"Stopped: {self._progress_in(store)}. {self._how_to_continue}") from None
        except CampaignStoppedError as problem:
            raise CampaignStoppedError(
                f"Stopped: {problem}. {self._progress_in(store)}. {self._how_to_continue}"
            ) from problem
        finally:
            store.close()

    @property
    def _how_to_continue(self) -> str:
        if self.store is None:
            return "They were in memory only and are lost."
        return "Run the same campaign again to continue from there."

    def _progress_in(self, store: RunStore | MemoryStore) -> str:
        return f"{len(store.rows)} of {len(self.keys)} runs are stored"

    def _is_part_of(self, store: RunStore | MemoryStore) -> bool:
        """Whether the store contains more runs than this design, including every run of this design."""
        return set(self.keys) < set(store.rows)

    def _selected(self) -> Runs:
        """Select the runs of the design from a store that contains more."""
        assert self.store is not None
        runs = open_runs(self.store)
        hashes = [r.content_hash for r in runs.records]
        row_of_key = {
            key: i for i, key in enumerate(_keys(runs.design.values, [hashes[i] for i in runs.record_of_run]))
        }
        return runs[np.array([row_of_key[key] for key in self.keys])]

    def _check_points(self, store: RunStore | MemoryStore) -> None:
        strangers = set(store.rows) - set(self.keys)
        if strangers:
            raise StoreMismatchError(
                f"store {self.store}",
                f"{len(strangers)} stored runs are at points that are not in this design of {len(self.keys)} points",
                "the stored design, or a longer design that contains it",
                "Append points with design + more. A longer 'sobol' or 'random' design contains the shorter one, but a Latin "
                "hypercube does not. Or name another store; this one is unchanged.",
            )

    def _todo(self, store: RunStore | MemoryStore, retry: bool, attempts: int) -> list[_Ticket]:
        """Runs that are not stored, failed runs with attempts left, and runs to be repeated."""
        tickets = []
        for row, key in enumerate(self.keys):
            stored = store.rows.get(key)
            if stored is None:
                tickets.append(_Ticket(row, 1))
            elif (retry and stored.status in RETRIED) or (stored.status in TRIED_AGAIN and stored.attempts < attempts):
                tickets.append(_Ticket(row, stored.attempts + 1))
        return tickets

    def _in_batches(self, store: RunStore | MemoryStore, todo: list[_Ticket], count: _Counter) -> None:
        for number, record in enumerate(self.records):
            rows = [t.row for t in todo if self.record_of_run[t.row] == number]
            for start in range(0, len(rows), BATCH):
                batch = rows[start : start + BATCH]
                done = self.model.simulate(self.theta[batch], record)
                finished = [
                    Finished(
                        self.keys[row],
                        Outcome(done.values[i], Status(done.status[i]), done.reasons[i], float(done.failure_time[i])),
                        1,
                    )
                    for i, row in enumerate(batch)
                ]
                store.append(finished)
                count.add(finished)

    def _one_by_one(
        self,
        store: RunStore | MemoryStore,
        todo: list[_Ticket],
        count: _Counter,
        executor: Any,
        attempts: int,
        retry: bool,
    ) -> None:
        model = as_guarded(self.model)
        calls = [packed(model, record) for record in self.records]
        with opened(executor) as pool:
            waiting = list(reversed(todo))
            # A run that was stopped between two attempts keeps its remaining attempts; a repeated run gets all attempts.
            last = {t.row: max(attempts, t.attempts + (attempts - 1 if retry else 0)) for t in todo}
            while waiting or pool.busy:
                while waiting and pool.room > 0:
                    self._submit(pool, waiting.pop(), calls)
                finished, again = self._take(pool, last)
                store.append(finished)
                waiting.extend(again)
                count.add([f for f in finished if not any(self.keys[t.row] == f.key for t in again)])

    def _submit(self, pool: Pool, ticket: _Ticket, calls: list[PackedCall]) -> None:
        number = self.record_of_run[ticket.row]
        task = as_guarded(self.model).task(self.theta[ticket.row], self.records[number], ticket.attempts)
        pool.submit(ticket, attempt, calls[number], task)

    def _take(self, pool: Pool, last: dict[int, int]) -> tuple[list[Finished], list[_Ticket]]:
        """Return the completed runs, and the runs to be repeated."""
        finished, again = [], []
        for ticket, outcome in pool.finished():
            if isinstance(outcome, LostWorkerError):
                nothing = np.full((len(self.records[self.record_of_run[ticket.row]]), len(self.model.channels)), np.nan)
                outcome = Outcome(nothing, Status.FAILED, f"it killed every worker that started it: {outcome}", 0.0)
            finished.append(Finished(self.keys[ticket.row], outcome, ticket.attempts))
            if outcome.status in TRIED_AGAIN and ticket.attempts < last[ticket.row]:
                again.append(_Ticket(ticket.row, ticket.attempts + 1))
        return finished, again


class _Counter:
    """A counter of completed and failed runs for a progress bar."""

    def __init__(
        self, store: RunStore | MemoryStore, keys: list[str], todo: list[_Ticket], progress: CampaignProgress | None
    ) -> None:
        pending = {keys[t.row] for t in todo}
        stored = [row for key, row in store.rows.items() if key not in pending]
        self.done, self.total, self.progress = len(stored), len(keys), progress
        self.failed = sum(Status(row.status).run_failed for row in stored)
        self.add([])

    def add(self, finished: Sequence[Finished]) -> None:
        self.done += len(finished)
        self.failed += sum(Status(f.outcome.status).run_failed for f in finished)
        if self.progress is not None:
            self.progress(self.done, self.total, self.failed)


def _keys(points: np.ndarray, record_hashes: list[str]) -> list[str]:
    """Return the key of each run, made from its point and record; repeated points get different keys."""
    counts: Counter[str] = Counter()
    keys = []
    for point, record in zip(points, record_hashes, strict=True):
        key = digest(np.asarray(point), record)
        keys.append(key if counts[key] == 0 else digest(key, counts[key]))
        counts[key] += 1
    return keys
