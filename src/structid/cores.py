"""How many cores this process may use."""

from __future__ import annotations

import os


def available_cores() -> int:
    """Count the cores this process may use.

    Returns
    -------
    int
        How many.
    """
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
