"""Memory of a test process: compiled programs that no later test needs are given back."""

import gc
import os
from pathlib import Path

import jax

from structid.core.freed_memory import return_freed_memory

LIMIT = 500.0
"""Memory [MB] above which a process gives back what it can."""

GROWTH = 80.0
"""Growth [MB] since the last time before it tries again."""


class Memory:
    """Watches the memory of this process."""

    def __init__(self):
        self.after_last = 0.0

    @property
    def in_use(self):
        """Resident memory of this process [MB]."""
        pages = int(Path("/proc/self/statm").read_text().split()[1]) if Path("/proc/self/statm").exists() else 0
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def give_back(self):
        """Drop JAX's compiled programs, and return free memory to the system; the next call of a program compiles it again."""
        if self.in_use < max(LIMIT, self.after_last + GROWTH):
            return
        jax.clear_caches()
        gc.collect()
        return_freed_memory()
        self.after_last = self.in_use
