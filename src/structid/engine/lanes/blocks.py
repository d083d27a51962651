"""Parallel work on all cores with threads, possible because compiled code releases the global interpreter lock.

The threads belong to one process. A forked process starts its own threads.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from structid.core.cores import cores_to_use

_pool: ThreadPoolExecutor | None = None
_lock = threading.Lock()


def _forget() -> None:
    global _pool, _lock
    _pool, _lock = None, threading.Lock()


os.register_at_fork(after_in_child=_forget)


def _threads(count: int) -> ThreadPoolExecutor:
    global _pool
    with _lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(count, thread_name_prefix="structid lanes")
        return _pool


def on_all_cores(work: Callable[[], None], parts: int) -> None:
    """Run `work` in at most one thread per core; each thread takes parts of the work until none is left."""
    cores = cores_to_use()
    others = [_threads(cores - 1).submit(work) for _ in range(min(cores, parts) - 1)]
    work()
    for other in others:
        # A thread that has not started yet has no work left.
        if not other.cancel():
            other.result()
