"""Cost of a campaign in addition to the solver, and its growth with the number of runs.

Run with ``python benchmarks/campaign.py [--quick]``. Programs that are not installed are omitted. UQpy needs an old
NumPy and may have a separate Python: ``UQPY_PYTHON=/path/to/python``.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import common
import numpy as np

import structid as si

NAME = "campaign"
SAMPLES, RUNS, MANY_RUNS = 4000, 500, 2500
STORED = (2500, 5000, 10_000)
LIMITS = {"processes": 2.0, "dask": 10.0}
"""Largest overhead of a run [ms]."""
RATE_LIMIT, OPEN_LIMIT = 200.0, 1.0
"""Smallest rate of stored runs [1/s], and longest time to open a store of 10 000 runs [s]."""

SPACE = si.ParameterSpace(a=si.Uniform(0.5, 1.5), b=si.Uniform(1.0, 9.0))
RECORD = si.GroundMotion(np.zeros(SAMPLES), 0.01, "none")


def instant(parameters: dict[str, float], record: Any) -> np.ndarray:
    """Solver of negligible cost, so that only the campaign is timed."""
    return parameters["a"] * np.sin(parameters["b"] * record.time)


# --- overhead -------------------------------------------------------------------------------------------------------


def campaign(executor: Any, runs: int) -> float:
    """Time of a stored campaign, from its creation to the finished file [s]."""
    model = si.CallableModel(instant, SPACE.names, ("velocity",))
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        found = si.Campaign(model, RECORD, SPACE.sample(runs, seed=1), Path(folder) / "runs.h5").run(executor)
        seconds = time.perf_counter() - began
        assert found.done.all()
        return seconds


@contextmanager
def dask_client() -> Iterator[Any]:
    """Dask client with two worker processes of one thread each, over loopback TCP."""
    from distributed import Client, LocalCluster

    settings = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with LocalCluster(silence_logs=50, **settings) as cluster, Client(cluster, set_as_default=False) as client:
        yield client


def with_joblib(runs: int) -> float:
    from joblib import Parallel, delayed
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor().shutdown()  # its start counts, as for the other programs
    points = [dict(zip(SPACE.names, row, strict=True)) for row in SPACE.sample(runs, seed=1).values]
    began = time.perf_counter()
    Parallel(n_jobs=2)(delayed(instant)(point, RECORD) for point in points)
    return time.perf_counter() - began


def with_plain_dask(client: Any, runs: int) -> float:
    points = [dict(zip(SPACE.names, row, strict=True)) for row in SPACE.sample(runs, seed=1).values]
    began = time.perf_counter()
    record = client.scatter(RECORD, broadcast=True, hash=False)
    client.gather(client.map(instant, points, record=record, pure=False))
    return time.perf_counter() - began


UQPY = """
import sys, time, numpy as np
from UQpy.run_model.RunModel import RunModel
from UQpy.run_model.model_execution.PythonModel import PythonModel
rng = np.random.default_rng(1)
points = rng.uniform([0.5, 1.0], [1.5, 9.0], (int(sys.argv[1]), 2))
model = RunModel(model=PythonModel(model_script="uqpy_model.py", model_object_name="instant"))
began = time.perf_counter()
model.run(samples=points)
print(time.perf_counter() - began)
"""
UQPY_MODEL = f"""
import numpy as np
TIME = np.arange({SAMPLES}) * 0.01
def instant(sample):
    a, b = np.ravel(sample)
    return a * np.sin(b * TIME)
"""


def with_uqpy(runs: int) -> float | None:
    """Time UQpy's RunModel in a separate serial process, since its parallel workflow needs mpirun."""
    python = os.environ.get("UQPY_PYTHON", sys.executable)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "uqpy_model.py").write_text(UQPY_MODEL)
        (Path(folder) / "run.py").write_text(textwrap.dedent(UQPY))
        done = subprocess.run(
            [python, "run.py", str(runs)],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
        )
    return float(done.stdout.split()[-1]) if done.returncode == 0 else None


def time_overhead(quick: bool) -> dict[str, list[float]]:
    """Milliseconds per run for every program: with the start, and without it from the difference of two campaign sizes."""
    repeats, few, many = (1, 100, 300) if quick else (3, RUNS, MANY_RUNS)
    found: dict[str, list[tuple[float, ...]]] = {}

    def measure(name: str, call: Callable[[int], float | None], sizes: tuple[int, ...] = (few, many)) -> None:
        seconds = tuple(call(size) for size in sizes)
        if None not in seconds:
            found.setdefault(name, []).append(seconds)  # type: ignore[arg-type]

    with dask_client() as client:
        campaign(client, 20)  # workers import their modules; a cluster exists before a campaign begins
        for _ in range(repeats):
            measure("serial", lambda n: campaign("serial", n))
            measure("processes", lambda n: campaign("processes", n))
            measure("dask", lambda n: campaign(client, n))
            measure("joblib, nothing stored", with_joblib)
            measure("plain dask, nothing stored", lambda n: with_plain_dask(client, n))
            measure("UQpy RunModel, serial, nothing stored", with_uqpy)
    rows = {}
    for name, seconds in found.items():
        first, second = np.median(np.array(seconds), axis=0)
        rows[name] = [1e3 * first / few, 1e3 * (second - first) / (many - few)]
    return rows


# --- the store ------------------------------------------------------------------------------------------------------

STORE = """
import re, sys, time
sys.path.insert(0, {here!r})
import campaign as c
import structid as si
from pathlib import Path
def peak():  # of this process only; ru_maxrss includes its parent's peak
    return int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text()).group(1)) / 1024
runs, path = int(sys.argv[1]), sys.argv[2]
model = si.CallableModel(c.instant, c.SPACE.names, ("velocity",), isolated=False)
design = c.SPACE.sample(runs, seed=1)
si.Campaign(model, c.RECORD, design[:50], path + ".warm").run()
base = peak()
began = time.perf_counter()
si.Campaign(model, c.RECORD, design, path).run()
print(runs / (time.perf_counter() - began), base, peak())
"""


def time_store(sizes: tuple[int, ...]) -> list[dict[str, float]]:
    """Rate, memory, size and opening time of stores, each written by a separate process."""
    rows = []
    for size in sizes:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "runs.h5"
            script = STORE.format(here=str(Path(__file__).parent))
            said = subprocess.run(
                [sys.executable, "-c", script, str(size), str(path)], capture_output=True, text=True, check=True
            ).stdout.split()
            rate, base, peak = (float(word) for word in said[-3:])
            rows.append(
                {"runs": size, "rate": rate, "base": base, "peak": peak, "megabytes": path.stat().st_size / 1e6}
                | dict(zip(("open", "one"), time_opening(path), strict=True))
            )
    return rows


def time_opening(path: Path) -> tuple[float, float]:
    """Seconds to open a store as `Runs` and as an xarray Dataset, and then to read one history from each."""
    si.open_runs(path).to_xarray().close()  # imports xarray
    began = time.perf_counter()
    runs = si.open_runs(path)
    data = runs.to_xarray()
    opened = time.perf_counter() - began
    began = time.perf_counter()
    np.testing.assert_array_equal(runs[len(runs) // 2].values[0], data["values"][len(runs) // 2])
    return opened, time.perf_counter() - began


# --- the page -------------------------------------------------------------------------------------------------------


def section(overhead: dict[str, list[float]], store: list[dict[str, float]]) -> str:
    told = [
        [name, f"{each:.2f}", f"{more:.2f}", f"{LIMITS[name]:g}" if name in LIMITS else "–"]
        for name, (each, more) in overhead.items()
    ]
    formats = {
        "runs": ",.0f",
        "rate": ".0f",
        "base": ".0f",
        "peak": ".0f",
        "megabytes": ".0f",
        "open": ".2f",
        "one": ".4f",
    }
    written = [[format(row[key], form) for key, form in formats.items()] for row in store]
    peaks = ("peak memory after 50 runs [MB]", "peak memory after all runs [MB]")
    heads = ["runs", "runs/s", *peaks, "file [MB]", "open [s]", "read one run [s]"]
    return f"""# Campaigns

`benchmarks/campaign.py`. {common.machine("distributed", "joblib", "h5py")}.

The solver returns {SAMPLES} samples in negligible time, so the table gives the overhead of the campaign. structid guards against
solvers that hang or crash. It writes every result to disk (fsync) before it waits for the next one. At the end, it writes all
results to one compressed file. The other programs do neither.

{common.markdown_table(["program", f"ms per run, {RUNS} runs with the start", "ms per further run", "limit"], told)}

Histories of {SAMPLES} samples, stored serially by a separate process; limits: {RATE_LIMIT:.0f} runs/s, {OPEN_LIMIT:g} s to open:

{common.markdown_table(heads, written)}
"""


def main() -> None:
    quick = common.is_quick(__doc__.splitlines()[0])
    overhead = time_overhead(quick)
    store = time_store((200, 400) if quick else STORED)
    common.record_result(NAME, quick=quick, machine=common.machine(), overhead=overhead, store=store)
    common.write_page(quick, NAME, section(overhead, store))
    print(section(overhead, store))


if __name__ == "__main__":
    main()
