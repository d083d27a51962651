"""Kill a campaign, its workers, its scheduler: nothing stored is lost or done again, the file is that of an undisturbed run."""

import os
import random
import re
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

import structid as si
from structid.campaign import parts

pytestmark = pytest.mark.slow  # three minutes of killing

HELPERS = Path(__file__).parents[1] / "helpers"
RUNS = 500
SCRIPT = f"""
import sys, numpy as np, structid as si, solvers
from structid.campaign import store
from structid.core.errors import StructidError
store.SEGMENT_BYTES = 150_000  # many segments in a short campaign
space = si.ParameterSpace(a=si.Uniform(0.0, 1.0), b=si.Normal(5.0, 1.0, low=1.0))
record = si.GroundMotion(np.sin(np.arange(300) * 0.05), 0.01, "sine")
model = si.CallableModel(solvers.logged_wave, space.names, ("velocity",))
try:
    si.Campaign(model, record, space.sample({RUNS}, seed=1), sys.argv[1]).run(sys.argv[2])
except StructidError as problem:
    print(problem)
    sys.exit(1)
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Starts the campaign in a process of its own; its runs are noted in a file."""
    script = tmp_path_factory.mktemp("script") / "campaign.py"
    script.write_text(textwrap.dedent(SCRIPT))

    def start(store, log, executor="processes:2"):
        environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(HELPERS), *sys.path]), CALLS=str(log))
        return subprocess.Popen(
            [sys.executable, str(script), str(store), executor], env=environment, stdout=subprocess.PIPE, text=True
        )

    return start


def stored_points(path):
    """First parameters of the runs that are stored; nothing before the campaign's first breath."""
    if not path.exists() and not (parts.parts_of(path) / "design").exists():
        return set()
    runs = si.open_runs(path)
    return {repr(float(a)) for a in runs.design.values[runs.done, 0]}


def called(log):
    return log.read_text().splitlines() if log.exists() else []


@pytest.fixture(scope="module")
def undisturbed(campaign, tmp_path_factory):
    folder = tmp_path_factory.mktemp("calm")
    assert campaign(folder / "calm.h5", folder / "calm.log").wait(timeout=120) == 0
    return si.open_runs(folder / "calm.h5")


def assert_same_data(path, undisturbed):
    runs = si.open_runs(path)
    assert runs.done.all() and len(runs) == RUNS
    np.testing.assert_array_equal(runs.values, undisturbed.values)
    np.testing.assert_array_equal(runs.design.values, undisturbed.design.values)
    assert not parts.parts_of(path).exists()


def test_killed_at_random_moments(campaign, undisturbed, tmp_path):
    path, log = tmp_path / "storm.h5", tmp_path / "storm.log"
    rng = random.Random(7)
    kills = began = 0
    for _ in range(10):
        before, calls_before = stored_points(path), len(called(log))
        process = campaign(path, log)
        # Not before it has started, since nothing is to be learnt from killing an import; then any time at all.
        while len(called(log)) == calls_before and process.poll() is None:
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.12))
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            kills += 1
        process.wait(timeout=60)
        new = called(log)[calls_before:]
        began += bool(new)
        assert not before & set(new), "a stored run was done again"
        assert before <= stored_points(path), "a stored run was lost"
    assert kills >= 7 and began == 10
    assert campaign(path, log).wait(timeout=120) == 0
    assert_same_data(path, undisturbed)
    redone = len(called(log)) - RUNS
    print(f"{kills} kills, {redone} runs done twice because they were under way")
    assert redone <= kills * 6  # two workers, two in flight for each, and those not yet stored


# --- Dask -----------------------------------------------------------------------------------------------------------


def dask(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:]],
        env=dict(os.environ, PYTHONPATH=os.pathsep.join([str(HELPERS), *sys.path]), CALLS=os.environ["CALLS"]),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def kill(process):
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """A scheduler and workers over loopback TCP, each a process; whatever is left of them is killed at the end."""
    pytest.importorskip("distributed")
    monkeypatch.setenv("CALLS", str(tmp_path / "dask.log"))
    import socket

    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    address, started = f"tcp://127.0.0.1:{port}", []

    def scheduler():
        started.append(dask("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"))
        return started[-1]

    def worker():
        started.append(
            dask("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60")
        )
        return started[-1]

    yield address, scheduler, worker
    for process in started:
        if process.poll() is None:
            kill(process)


def wait_for_calls(log, count, process):
    deadline = time.monotonic() + 90
    while len(called(log)) < count and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_dask_workers_die_and_all_runs_complete(campaign, undisturbed, cluster, tmp_path):
    address, scheduler, worker = cluster
    scheduler()
    workers = [worker() for _ in range(4)]
    path, log = tmp_path / "dask.h5", tmp_path / "dask.log"
    process = campaign(path, log, address)
    for count in (60, 160, 260):
        wait_for_calls(log, count, process)
        for victim in workers[:2]:
            kill(victim)
        workers = [*workers[2:], worker(), worker()]
    assert process.wait(timeout=180) == 0, process.stdout.read()
    assert_same_data(path, undisturbed)


def test_the_scheduler_dies_and_the_campaign_says_so_and_goes_on(campaign, undisturbed, cluster, tmp_path):
    address, scheduler, worker = cluster
    first, path, log = scheduler(), tmp_path / "dask.h5", tmp_path / "dask.log"
    workers = [worker(), worker()]
    process = campaign(path, log, address)
    wait_for_calls(log, 100, process)
    kill(first)
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 1
    assert re.search(r"Stopped: the (scheduler at|connection to the scheduler) .*was lost", said), said
    assert "of 500 runs are stored. Run the same campaign again" in said
    for old in workers:
        kill(old)
    stored = stored_points(path)
    assert 50 < len(stored) < RUNS
    scheduler()
    workers = [worker(), worker()]
    calls_before = len(called(log))
    again = campaign(path, log, address)
    assert again.wait(timeout=180) == 0, again.stdout.read()
    assert not stored & set(called(log)[calls_before:])
    assert_same_data(path, undisturbed)
