"""Where runs are done: here, in local processes, on any executor of `concurrent.futures`, on a Dask cluster; all with one face."""

from __future__ import annotations

import contextlib
import math
import queue
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ThreadPoolExecutor
from typing import Any

from structid.cores import available_cores
from structid.errors import CampaignStoppedError, InputError
from structid.models.face import Map, Model
from structid.solvers.guard import guard_of_this_thread
from structid.solvers.watchdog import Watchdog

CONNECTION_LIMIT = 8.0
"""Seconds a scheduler may take to answer."""

RECOUNT = 1.0
"""Seconds after which a cluster's workers are counted again: they come and go."""

ALLOWED = "'serial', 'processes', 'processes:4', 'tcp://scheduler:8786', a concurrent.futures.Executor or a dask Client"


class LostWorkerError(Exception):
    """A run has taken down so many workers, one after another, that its scheduler has given it up."""


class Pool:
    """Runs in flight on an executor: their number is bounded, and they come back as they finish.

    Parameters
    ----------
    executor : object
        Has ``submit``; its futures have ``add_done_callback``, ``result`` and ``cancel``.
    workers : callable
        How many runs it can do at once, now.
    release : callable
        Called at the end with whether to abort what is running.
    check : callable
        Called while nothing comes back; raises when nothing ever will.
    options : dict
        For ``submit``.
    """

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
        """How many more runs may be submitted: two for each worker are in flight at most, so that none waits for work."""
        return 2 * max(self._workers(), 1) - len(self._tickets)

    @property
    def busy(self) -> bool:
        """Whether anything is in flight."""
        return bool(self._tickets)

    def submit(self, ticket: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Hand a run over.

        Parameters
        ----------
        ticket : Any
            Comes back with the result.
        function : callable
            To be called there.
        *arguments
            Its arguments.
        """
        try:
            future = self._executor.submit(function, *arguments, **self._options)
        except (BrokenExecutor, RuntimeError) as problem:
            raise CampaignStoppedError(f"the executor takes no more runs ({problem})") from problem
        self._tickets[future] = ticket
        future.add_done_callback(self._finished.put)

    def finished(self) -> Iterator[tuple[Any, Any]]:
        """Wait for a run to finish; take all that have.

        Yields
        ------
        tuple of ticket and result
            The result is an exception `LostWorkerError` where a worker died.

        Raises
        ------
        CampaignStoppedError
            If the executor can do no more.
        """
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
        """Lend the workers to one who leaves them open.

        Returns
        -------
        Pool
            Its `close` gives up no more than what was submitted to it.
        """
        return Pool(self._executor, self._workers, check=self._check, options=self._options)

    def close(self, abort: bool = False) -> None:
        """Let go of the executor.

        Parameters
        ----------
        abort : bool
            Cancel what is in flight instead of having waited for it.
        """
        if abort:
            for future in self._tickets:
                with contextlib.suppress(Exception):
                    future.cancel()
        self._release(abort)


def _result_of(future: Any) -> Any:
    try:
        return future.result()
    except BrokenExecutor as problem:
        raise CampaignStoppedError(f"the executor broke down: {type(problem).__name__} {problem}".rstrip()) from problem
    except CampaignStoppedError:
        raise
    except Exception as problem:
        # By name, so that distributed need not be there.
        if type(problem).__name__ == "KilledWorker":
            return LostWorkerError(str(problem).split("\n")[0])
        if isinstance(problem, CancelledError) or "CommClosed" in type(problem).__name__:
            raise CampaignStoppedError("the scheduler, or whoever else kept the runs in flight, was lost") from problem
        raise CampaignStoppedError(
            f"a worker could not even begin a run: {type(problem).__name__}: {problem}. "
            "Has it the same structid and Python as here?"
        ) from problem


def _pool_of(executor: Any) -> Pool:
    """Make a pool, to be closed, of whatever was given as an executor; see `opened`."""
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
    """Threads, each the owner of a child process that does its runs."""
    guards: list[Watchdog] = []
    threads = ThreadPoolExecutor(workers, "structid-run", initializer=lambda: guards.append(guard_of_this_thread()))

    def release(abort: bool) -> None:
        if abort:
            threads.shutdown(wait=False, cancel_futures=True)
            for guard in guards:  # a thread that waits for its child then sees it die
                guard.kill()
        threads.shutdown(wait=True)
        for guard in guards:
            guard.close()

    return Pool(threads, lambda: workers, release)


def _connected(address: str) -> Any:
    import logging

    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            f"executor '{address}'", "Dask is not installed here", "the extra 'dask'", "pip install 'structid[dask]'."
        ) from None
    for name in ("distributed", "distributed.client", "distributed.core", "distributed.comm"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what there is to say is said by us, in one line
    try:
        return Client(address, timeout=CONNECTION_LIMIT, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as problem:
        raise InputError(
            f"executor '{address}'", f"no Dask scheduler answers there ({type(problem).__name__})",
            "the address of a running scheduler", "Start one with: dask scheduler --port 8786.",
        ) from None  # fmt: skip


def _dask(client: Any, address: str, release: Callable[[bool], None]) -> Pool:
    asked, threads = -math.inf, 0

    def workers() -> int:
        nonlocal asked, threads
        if time.monotonic() > asked + RECOUNT:  # a question to the scheduler costs as much as a run
            try:
                asked, threads = time.monotonic(), sum(client.nthreads().values())
            except Exception as problem:  # whatever it is, the scheduler does not answer
                raise CampaignStoppedError(f"the scheduler at {address} was lost") from problem
        return threads

    def check() -> None:
        if client.status != "running":
            raise CampaignStoppedError(f"the scheduler at {address} was lost")

    return Pool(client, workers, release, check, {"pure": False, "retries": 0})


@contextlib.contextmanager
def opened(executor: Any) -> Iterator[Pool]:
    """Open a pool of whatever was given as an executor, and close it in the end; after an exception, what is in flight is given up.

    Parameters
    ----------
    executor : None, str, Pool, concurrent.futures.Executor or distributed.Client
        ``None`` and ``"serial"``: one run after another; ``"processes"``: one local process for each core, ``"processes:4"`` four;
        ``"tcp://host:8786"``: a Dask scheduler. What is given as an object stays the caller's, who closes it.

    Yields
    ------
    Pool
        The pool.

    Raises
    ------
    InputError
        If it is none of these, or no scheduler answers.
    """
    pool, abort = _pool_of(executor), True
    try:
        yield pool
        abort = False
    finally:
        pool.close(abort)


def kept_open(model: Model, executor: Any) -> contextlib.AbstractContextManager[Any]:
    """Open an executor once for everything that an external model is run for: starting workers can take longer than a run.

    Parameters
    ----------
    model : Model
        Whose runs they are.
    executor : None, str, Pool, concurrent.futures.Executor or distributed.Client
        As for `opened`.

    Returns
    -------
    context manager
        Gives what to pass on as an executor; for a built-in model, which needs none, what came.
    """
    return opened(executor) if model.guarded else contextlib.nullcontext(executor)


@contextlib.contextmanager
def mapping(executor: Any) -> Iterator[Callable[..., Iterable[Any]]]:
    """Open an executor as a `map`, for `Model.simulate` and `Posterior`.

    Parameters
    ----------
    executor : None, str, concurrent.futures.Executor or distributed.Client
        As for `opened`.

    Yields
    ------
    callable
        Applies a function to every element of a sequence and returns the results in order.
    """
    with opened(executor) as pool:

        def mapped(function: Callable[..., Any], items: Iterable[Any]) -> list[Any]:
            waiting = list(enumerate(items))
            results: list[Any] = [None] * len(waiting)
            waiting.reverse()
            while waiting or pool.busy:
                while waiting and pool.room > 0:
                    place, item = waiting.pop()
                    pool.submit(place, function, item)
                for place, result in pool.finished():
                    if isinstance(result, LostWorkerError):
                        raise CampaignStoppedError(f"run {place} took every worker down that tried it: {result}")
                    results[place] = result
            return results

        yield mapped


def run_map(model: Model, executor: Any) -> contextlib.AbstractContextManager[Map | None]:
    """Open an executor for the runs of an external model; a built-in one runs in batches, and needs none.

    Parameters
    ----------
    model : Model
        Whose runs they are.
    executor : None, str, concurrent.futures.Executor or distributed.Client
        As for `opened`.

    Returns
    -------
    context manager
        Gives a `map`, or None for a built-in model.
    """
    return mapping(executor) if model.guarded else contextlib.nullcontext()
