"""External models: whatever a solver does, it becomes a row with a status and a reason, and the next run goes on."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest

import solvers
import structid as si
from processes import wait_until_gone
from structid.core.errors import InputError, Status
from structid.models.external.guard import attempt, packed

RECORD = si.GroundMotion(np.sin(np.arange(400) * 0.05), 0.01, "sine")


def outcomes(function, a, **settings):
    model = si.CallableModel(function, ("a",), ("velocity",), **settings)
    return model.simulate(np.array(a, dtype=float)[:, None], RECORD)


EXPECTED = {
    0: (Status.DONE, "", 400),
    1: (Status.FAILED, "the solver returned 393 rows; expected 400 rows of velocity", 393),
    2: (Status.DIVERGED, "not finite from 1 s on", 100),
    3: (Status.FAILED, "shape (400, 3); expected 400 rows of velocity", 0),
    4: (Status.FAILED, "the solver returned nothing", 0),
    5: (Status.FAILED, "exit code 3; it last said: matrix is singular", 0),
    6: (Status.TIMED_OUT, "no answer within 0.5 s; it last said: still iterating", 0),
    7: (Status.FAILED, "killed by signal 9 (SIGKILL)", 0),
    8: (Status.FAILED, "ArithmeticError: no convergence in step 12 (solvers.py, line", 0),
    9: (Status.FAILED, "gave up", 50),
    10: (Status.FAILED, "the solver returned speed, but no 'velocity'", 0),
    11: (Status.FAILED, "the solver returned strings such as 'what?'; expected 400 rows of velocity", 0),
}


def test_every_way_to_fail_has_its_own_status_and_reason_and_stops_nothing():
    found = outcomes(solvers.misbehaving, [*EXPECTED, 0], time_limit=0.5)
    for i, (status, reason, rows) in enumerate(EXPECTED.values()):
        assert (found.status[i], reason in found.reasons[i]) == (status, True), (i, found.reasons[i])
        assert np.isfinite(found.values[i]).all(axis=1).sum() == rows, i
    assert found.done[-1] and found.reasons[-1] == ""
    assert len(set(found.reasons)) == len(EXPECTED)


def test_a_run_in_the_calling_process_gives_the_same():
    points = [0.3, 1.7]
    guarded = outcomes(lambda p, r: p["a"] * r.values, points)
    here = outcomes(lambda p, r: p["a"] * r.values, points, isolated=False)
    np.testing.assert_array_equal(guarded.values, here.values)
    np.testing.assert_array_equal(here.values[1, :, 0], 1.7 * RECORD.values)


def test_a_function_that_cannot_travel_is_told_so_at_once():
    lock = threading.Lock()
    with pytest.raises(InputError, match=r"cannot be sent to another process.*isolated=False"):
        outcomes(lambda p, r: lock and r.values, [1.0])
    assert outcomes(lambda p, r: lock and r.values, [1.0], isolated=False).done.all()


def test_a_solver_may_use_jax_itself():
    found = outcomes(solvers.with_jax, [1.0, 2.0])
    assert found.done.all(), found.reasons
    model = si.BoucWen(mass=1.0, damping_ratio=0.05, alpha=1.0, beta=0.0, gamma=0.0, free=("stiffness",))
    here = model.simulate(np.array([[100.0], [200.0]]), RECORD)
    np.testing.assert_allclose(found.values, here.values, rtol=1e-9, atol=1e-12)


def test_seeds_depend_on_the_run_alone():
    model = si.CallableModel(solvers.noisy_wave, ("a", "b"), ("velocity",))
    theta = np.array([[1.0, 2.0], [1.0, 2.0], [1.5, 2.0]])
    one, two = model.simulate(theta, RECORD).values, model.simulate(theta[::-1], RECORD).values
    np.testing.assert_array_equal(one, two[::-1])
    np.testing.assert_array_equal(one[0], one[1])
    assert not np.allclose(one[0], one[2] - 0.5 * np.sin(2.0 * RECORD.time)[:, None])


def test_the_hash_knows_the_code_and_what_it_closes_over():
    def scaled(by):
        return si.CallableModel(lambda p, r: by * r.values, ("a",), ("velocity",)).content_hash

    assert scaled(1.0) == scaled(1.0) != scaled(2.0)
    other = si.CallableModel(lambda p, r: 1.0 + r.values, ("a",), ("velocity",)).content_hash
    assert other not in (scaled(1.0), scaled(2.0))


def test_nothing_is_left_when_the_owner_is_killed(tmp_path):
    """Kill −9 the process that runs a solver: the solver and what it has started die with it."""
    script = tmp_path / "owner.py"
    script.write_text(
        textwrap.dedent(f"""
        import subprocess, sys, os, numpy as np, structid as si
        def solver(p, record):
            sleeper = subprocess.Popen(["sleep", "300"])
            open({str(tmp_path / "pids")!r}, "w").write(f"{{os.getpid()}} {{sleeper.pid}}")
            sleeper.wait()
        si.CallableModel(solver, ("a",), ("v",)).simulate(np.ones((1, 1)), si.GroundMotion(np.zeros(3), 0.1))
        """)
    )
    owner = subprocess.Popen([sys.executable, str(script)])
    deadline = time.monotonic() + 60
    while not (tmp_path / "pids").exists() or not (tmp_path / "pids").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    time.sleep(0.1)
    pids = [int(p) for p in (tmp_path / "pids").read_text().split()]
    owner.send_signal(signal.SIGKILL)
    owner.wait()
    wait_until_gone(pids, deadline - time.monotonic())


def test_several_records_one_for_each_run():
    model = si.CallableModel(solvers.wave, ("a", "b"), ("velocity",))
    other = si.GroundMotion(np.cos(np.arange(400) * 0.03), 0.01, "cosine")
    theta = np.array([[1.0, 2.0], [0.5, 3.0], [0.2, 1.0]])
    mixed = model.simulate(theta, [RECORD, other, RECORD])
    np.testing.assert_array_equal(mixed.values[1], model.simulate(theta[1:2], other).values[0])
    np.testing.assert_array_equal(mixed.values[[0, 2]], model.simulate(theta[[0, 2]], RECORD).values)
    with pytest.raises(InputError, match="2 excitations for 3 runs"):
        model.simulate(theta, [RECORD, other])
    with pytest.raises(InputError, match="different time steps or lengths"):
        model.simulate(theta, [RECORD, other, other.trim(0.0, 1.0)])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: si.CallableModel(3, ("a",), ("v",)), "a function of"),
        (lambda: si.CallableModel(len, ("a",), ()), "different names"),
        (lambda: si.CallableModel(len, ("a",), ("v",), time_limit=-1.0), "positive"),
        (
            lambda: si.CallableModel(len, ("a",), ("v",), time_limit=1.0, isolated=False),
            "either a time limit or isolated=False",
        ),
    ],
)
def test_bad_models_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_a_packed_call_does_its_work_wherever_it_is_unpickled():
    import pickle

    model = si.CallableModel(solvers.wave, ("a", "b"), ("velocity",))
    task = model.task(np.array([1.0, 2.0]), RECORD)
    call = pickle.loads(pickle.dumps(packed(model, RECORD)))
    np.testing.assert_array_equal(attempt(call, task).values[:, 0], solvers.wave(task.parameters, RECORD))
    assert os.getpid()  # this process is none the worse


def test_the_state_of_a_solver_is_part_of_its_identity():
    def hashed(function):
        return si.CallableModel(function, ("a", "b"), ("velocity",)).content_hash

    assert hashed(solvers.Frame(2.0)) == hashed(solvers.Frame(2.0)) != hashed(solvers.Frame(3.0))
    assert (
        hashed(solvers.Frame(2.0).respond) == hashed(solvers.Frame(2.0).respond) != hashed(solvers.Frame(3.0).respond)
    )
