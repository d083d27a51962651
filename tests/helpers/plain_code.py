"""How tests compile: most of what they compile runs for less time than that takes. As a program it runs another one so."""

import os
import runpy
import sys
from pathlib import Path

from structid.engine.lanes import machine

SLOW_TESTS = "" if sys.version_info >= (3, 12) else "--xla_cpu_use_fusion_emitters=false"
"""XLA's flags for what runs longer than it compiles: its older way of writing code takes a fifth of the time of a calibration off.
JAX 0.12, which needs Python 3.12, does not know it, and ends the process without a word."""
QUICK_TESTS = f"{SLOW_TESTS} --xla_backend_optimization_level=0"
"""For what runs for a moment: the plainest code."""
LONG = 200_000
"""Length of a text that is as long as a wall's: LLVM's plainest code for it takes a sixth of the time, and runs three quarters as
fast."""


def of_long_loops():
    """Let LLVM write its plainest code of long texts."""
    as_users_do = machine.levels
    machine.levels = lambda text: (0, 0) if len(text) > LONG else as_users_do(text)


if __name__ == "__main__":
    os.environ["XLA_FLAGS"] = QUICK_TESTS
    of_long_loops()
    del sys.argv[0]
    sys.path[0] = str(Path(sys.argv[0]).parent)
    runpy.run_path(sys.argv[0], run_name="__main__")
