"""Tests that run side by side share the cores: imported before NumPy, whose linear algebra counts its threads when it is loaded.

Two workers with a thread for each core wait for one another most of the time: a study took half as long again.
"""

import os

WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))

if WORKERS > 1:
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, str(max(1, (os.cpu_count() or 1) // WORKERS)))
