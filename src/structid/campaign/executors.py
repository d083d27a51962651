"""Common interface to executors of runs: serial, local processes, `concurrent.futures` executors, a Dask cluster."""

from __future__ import annotations

import contextlib
import logging
import math
import queue
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ThreadPoolExecutor
from typing import Any

from structid.core.cores import available_cores
from structid.core.errors import CampaignStoppedError, InputError
from structid.models.base import Map, Model
from structid.models.external.guard import guard_of_this_thread
from structid.models.external.watchdog import Watchdog

CONNECTION_LIMIT = 8.0
"""Timeout for the answer of a scheduler [s]."""

RECOUNT = 1.0
"""Time between two counts of the workers of a cluster, whose number may change [s]."""

ALLOWED = "'serial', 'processes', 'processes:4', 'tcp://scheduler:8786', a concurrent.futures.Executor or a dask Client"


class LostWorkerError(Exception):
    """A run killed several workers in succession, so the scheduler abandoned it."""


class Pool:
    """A limited number of runs submitted to an executor; each result is returned when its run finishes."""

    def __init__(
        self,
        executor: Any,
        workers: Callable[[], int],
        release: Callable[[bool], None] = lambda abort: None,
        check: Callable[[], None] = lambda: None,
        options: dict[str, Any] | None = None,
    ) -> None:
        self._executor, self._workers, self._release, self._check = executor, workers, release, check
        self._options = options or {}
        self._finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._tickets: dict[Any, Any] = {}

    @property
    def room(self) -> int:
        """Number of runs that may be submitted now: at most two runs for each worker, so that no worker is idle."""
        return 2 * max(self._workers(), 1) - len(self._tickets)

    @property
    def busy(self) -> bool:
        """Whether a submitted run is still unfinished."""
        return bool(self._tickets)

    def submit(self, ticket: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Submit a run."""
        try:
            future = self._executor.submit(function, *arguments, **self._options)
        except (BrokenExecutor, RuntimeError) as problem:
            raise CampaignStoppedError(f"the executor accepts no more runs ({problem})") from problem
        self._tickets[future] = ticket
        future.add_done_callback(self._finished.put)

    def finished(self) -> Iterator[tuple[Any, Any]]:
        """Wait until a run has finished, and return all finished runs."""
        futures = [self._next()]
        with contextlib.suppress(queue.Empty):
            while True:
                futures.append(self._finished.get_nowait())
        for future in futures:
            ticket = self._tickets.pop(future, None)
            if ticket is not None:
                yield ticket, _result_of(future)

    def _next(self) -> Any:
        while True:
            try:
                return self._finished.get(timeout=1.0)
            except queue.Empty:
                self._check()

    def lent(self) -> Pool:
        """Return another pool on the same executor; closing this pool leaves the executor open."""
        return Pool(self._executor, self._workers, check=self._check, options=self._options)

    def close(self, abort: bool = False) -> None:
        """Release the executor."""
        if abort:
            for future in self._tickets:
                with contextlib.suppress(Exception):
                    future.cancel()
        self._release(abort)


def _result_of(future: Any) -> Any:
    try:
        return future.result()
    except BrokenExecutor as problem:
        raise CampaignStoppedError(f"the executor failed: {type(problem).__name__} {problem}".rstrip()) from problem
    except CampaignStoppedError:
        raise
    except Exception as problem:
        # The type is compared by name, because distributed may not be installed.
        if type(problem).__name__ == "KilledWorker":
            return LostWorkerError(str(problem).split("\n")[0])
        if isinstance(problem, CancelledError) or "CommClosed" in type(problem).__name__:
            raise CampaignStoppedError("the connection to the scheduler or executor was lost") from problem
        raise CampaignStoppedError(
            f"a worker could not start a run: {type(problem).__name__}: {problem}. "
            "Check that it has the same versions of structid and Python as this machine"
        ) from problem


def _pool_of(executor: Any) -> Pool:
    """Make a pool from the executor argument of `opened`; the caller closes it."""
    if isinstance(executor, Pool):
        return executor.lent()
    if executor is None or executor == "serial":
        return _local(1)
    if isinstance(executor, str):
        kind, _, rest = executor.partition(":")
        if kind == "processes" and (not rest or (rest.isdigit() and int(rest) > 0)):
            return _local(int(rest) if rest else available_cores())
        if "://" in executor:
            client = _connected(executor)
            return _dask(client, executor, lambda abort: client.close(timeout=2))
    elif isinstance(executor, Executor):
        workers = int(getattr(executor, "_max_workers", 0) or available_cores())
        return Pool(executor, lambda: workers)
    elif hasattr(executor, "scheduler_info") and hasattr(executor, "submit"):
        return _dask(executor, str(executor.scheduler.address), lambda abort: None)
    raise InputError("executor", f"{executor!r}", ALLOWED)


def _local(workers: int) -> Pool:
    """Make a pool of threads, each of which executes its runs in its own child process."""
    guards: list[Watchdog] = []
    threads = ThreadPoolExecutor(workers, "structid-run", initializer=lambda: guards.append(guard_of_this_thread()))

    def release(abort: bool) -> None:
        if abort:
            threads.shutdown(wait=False, cancel_futures=True)
            for guard in guards:  # a thread that is waiting for its child process then returns
                guard.kill()
        threads.shutdown(wait=True)
        for guard in guards:
            guard.close()

    return Pool(threads, lambda: workers, release)


def _connected(address: str) -> Any:
    try:
        from distributed import Client  # an optional dependency
    except ImportError:
        raise InputError(
            f"executor '{address}'", "Dask is not installed", "the extra 'dask'", "Run: pip install 'structid[dask]'."
        ) from None
    for name in ("distributed", "distributed.client", "distributed.core", "distributed.comm"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # structid reports a lost connection in one line
    try:
        return Client(address, timeout=CONNECTION_LIMIT, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as problem:
        raise InputError(
            f"executor '{address}'",
            f"no Dask scheduler answers at this address ({type(problem).__name__})",
            "the address of a running scheduler",
            "Start one with: dask scheduler --port 8786.",
        ) from None


def _dask(client: Any, address: str, release: Callable[[bool], None]) -> Pool:
    counted_at, threads = -math.inf, 0

    def workers() -> int:
        nonlocal counted_at, threads
        if time.monotonic() > counted_at + RECOUNT:  # a request to the scheduler takes as long as a short run
            try:
                counted_at, threads = time.monotonic(), sum(client.nthreads().values())
            except Exception as problem:  # any exception means that the scheduler does not answer
                raise CampaignStoppedError(f"the scheduler at {address} was lost") from problem
        return threads

    def check() -> None:
        if client.status != "running":
            raise CampaignStoppedError(f"the scheduler at {address} was lost")

    return Pool(client, workers, release, check, {"pure": False, "retries": 0})


@contextlib.contextmanager
def opened(executor: Any) -> Iterator[Pool]:
    """Open a pool on an executor and close it at the end; after an exception, unfinished runs are aborted."""
    pool, abort = _pool_of(executor), True
    try:
        yield pool
        abort = False
    finally:
        pool.close(abort)


def kept_open(model: Model, executor: Any) -> contextlib.AbstractContextManager[Any]:
    """Open an executor once for all runs of an external model, because starting workers can take longer than a run."""
    return contextlib.nullcontext(executor) if model.batched else opened(executor)


@contextlib.contextmanager
def mapping(executor: Any) -> Iterator[Callable[..., Iterable[Any]]]:
    """Open an executor as a `map` function, for `Model.simulate` and `Posterior`."""
    with opened(executor) as pool:

        def mapped(function: Callable[..., Any], items: Iterable[Any]) -> list[Any]:
            waiting = list(enumerate(items))
            results: list[Any] = [None] * len(waiting)
            waiting.reverse()
            while waiting or pool.busy:
                while waiting and pool.room > 0:
                    index, item = waiting.pop()
                    pool.submit(index, function, item)
                for index, result in pool.finished():
                    if isinstance(result, LostWorkerError):
                        raise CampaignStoppedError(f"run {index} killed every worker that started it: {result}")
                    results[index] = result
            return results

        yield mapped


def run_map(model: Model, executor: Any) -> contextlib.AbstractContextManager[Map | None]:
    """Open an executor for the runs of an external model; a built-in model runs in batches and needs none."""
    return contextlib.nullcontext() if model.batched else mapping(executor)
