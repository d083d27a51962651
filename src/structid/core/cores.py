"""Number of cores and threads for this process, and the folder for compiled code."""

from __future__ import annotations

import functools
import multiprocessing
import os
from contextlib import AbstractContextManager
from pathlib import Path

import threadpoolctl


def available_cores() -> int:
    """Count the cores that the operating system grants this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cores_to_use() -> int:
    """Count the cores that this process should use."""
    alone = multiprocessing.parent_process() is None
    return max(int(os.environ.get("JAX_NUM_CPU_DEVICES", available_cores() if alone else 1)), 1)


@functools.cache
def _blas() -> threadpoolctl.ThreadpoolController:
    """Controllers of the BLAS libraries in this process, cached because the search for them takes as long as a small fit."""
    return threadpoolctl.ThreadpoolController().select(user_api="blas")


def blas_threads(count: int | None) -> AbstractContextManager[object]:
    """Limit the number of BLAS threads inside a ``with`` block."""
    limited: AbstractContextManager[object] = _blas().limit(limits=count)
    return limited


def cache_folder(name: str) -> Path:
    """Return the folder that keeps compiled code between processes."""
    return Path(os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))) / "structid" / name
