"""How many cores and threads this process may use, and where it keeps what it compiles for them."""

from __future__ import annotations

import functools
import multiprocessing
import os
from contextlib import AbstractContextManager
from pathlib import Path

import threadpoolctl


def available_cores() -> int:
    """Count the cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cores_to_use() -> int:
    """Count the cores this process is to use."""
    alone = multiprocessing.parent_process() is None
    return max(int(os.environ.get("JAX_NUM_CPU_DEVICES", available_cores() if alone else 1)), 1)


@functools.cache
def _blas() -> threadpoolctl.ThreadpoolController:
    """The libraries of linear algebra in this process. To look for them takes as long as a small fit."""
    return threadpoolctl.ThreadpoolController().select(user_api="blas")


def blas_threads(count: int | None) -> AbstractContextManager[object]:
    """Limit the threads of the linear algebra for a while."""
    limited: AbstractContextManager[object] = _blas().limit(limits=count)
    return limited


def cache_folder(name: str) -> Path:
    """Where compiled code is kept from one process to the next."""
    return Path(os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))) / "structid" / name
