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
from structid.errors import InputError, Status
from structid.solvers.guard import attempt, packed
from structid.solvers.um_bridge import ServedModel
from studies import PLAIN, shortened

RECORD = si.GroundMotion(np.sin(np.arange(400) * 0.05), 0.01, "sine")


def outcomes(function, a, **settings):
    model = si.CallableModel(function, ("a",), ("velocity",), **settings)
    return model.simulate(np.array(a, dtype=float)[:, None], RECORD)


EXPECTED = {
    0: (Status.DONE, "", 400),
    1: (Status.FAILED, "it returned 393 rows; wanted 400 rows of velocity", 393),
    2: (Status.DIVERGED, "not finite from 1 s on", 100),
    3: (Status.FAILED, "shape (400, 3); wanted 400 rows of velocity", 0),
    4: (Status.FAILED, "it returned nothing", 0),
    5: (Status.FAILED, "exit code 3; it last said: matrix is singular", 0),
    6: (Status.TIMED_OUT, "no answer within 0.5 s; it last said: still iterating", 0),
    7: (Status.FAILED, "killed by signal 9 (SIGKILL)", 0),
    8: (Status.FAILED, "ArithmeticError: no convergence in step 12 (solvers.py, line", 0),
    9: (Status.FAILED, "gave up", 50),
    10: (Status.FAILED, "there is no 'velocity' among the returned speed", 0),
    11: (Status.FAILED, "could not convert string", 0),
}


@pytest.mark.quick
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
    with pytest.raises(InputError, match="different steps or lengths"):
        model.simulate(theta, [RECORD, other, other.trim(0.0, 1.0)])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: si.CallableModel(3, ("a",), ("v",)), "a function of"),
        (lambda: si.CallableModel(len, ("a",), ()), "each once"),
        (lambda: si.CallableModel(len, ("a",), ("v",), time_limit=-1.0), "positive"),
        (lambda: si.CallableModel(len, ("a",), ("v",), time_limit=1.0, isolated=False), "one of the two"),
    ],
)
def test_bad_models_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


# --- programs -------------------------------------------------------------------------------------------------------

PROGRAM = """
import sys, time, os
a, n = [float(w) for w in open("input.txt").read().split()]
n = int(n)
kind = sys.argv[1]
rows = ["time,velocity,extra"] + [f"{i * 0.01!r},{a * i!r},0" for i in range(n)]
if kind == "short": rows = rows[:-30]
if kind == "nan": rows[200] = "1.99,nan,0"
if kind == "torn": rows[-1] = rows[-1][:3]
if kind == "garbage": rows[100] = "Error: negative Jacobian"
if kind == "columns": rows = [r.rsplit(",", 2)[0] for r in rows]
if kind != "nothing": open("out.csv", "w").write("\\n".join(rows))
print("a is", a)
if kind == "exit": print("zero pivot", file=sys.stderr); sys.exit(3)
if kind == "hang": sys.stdout.flush(); time.sleep(60)
if kind == "signal": os.kill(os.getpid(), 15)
"""


@pytest.fixture
def program(tmp_path):
    (tmp_path / "solver.py").write_text(PROGRAM)
    (tmp_path / "input.j2").write_text('{{ stiffness | unit("kN/mm") }} {{ record.samples }}')

    def make(kind="good", columns={"velocity": "velocity"}, **settings):  # noqa: B006
        output = settings.pop("output", None) or si.OutputFile("out.csv", columns)
        return si.ProgramModel(
            [sys.executable, "{{ folder }}/solver.py", kind], ("stiffness",), output, {"input.txt": "input.j2"},
            folder=tmp_path, scratch=tmp_path / "scratch", **settings,
        )  # fmt: skip

    return make


STIFFNESS = np.array([[7.123456789012345e6]])


def test_a_program_gets_its_input_and_its_histories_are_read(program, tmp_path):
    found = program(keep="all").simulate(STIFFNESS, RECORD)
    assert found.done.all(), found.reasons
    np.testing.assert_allclose(found.values[0, :, 0], 7.123456789012345 * np.arange(400), rtol=1e-15)
    (scratch,) = (tmp_path / "scratch").iterdir()
    assert {p.name for p in scratch.iterdir()} == {"input.txt", "out.csv", "output.txt"}
    in_mm = program(output=si.OutputFile("out.csv", {"velocity": 1}, {"velocity": "mm/s"}))
    np.testing.assert_allclose(in_mm.simulate(STIFFNESS, RECORD).values, found.values * 1e-3)


@pytest.mark.parametrize(
    ("kind", "status", "words", "rows"),
    [
        ("short", Status.FAILED, "returned 370 rows", 370),
        ("nan", Status.DIVERGED, "not finite from 1.99 s on", 199),
        ("torn", Status.FAILED, "returned 399 rows", 399),
        ("garbage", Status.FAILED, "line 101 of 'out.csv' is no row of numbers: 'Error: negative Jacobian'", 0),
        ("columns", Status.FAILED, "no column 'velocity'", 0),
        ("nothing", Status.FAILED, "it wrote no 'out.csv'; its folder holds input.txt, output.txt", 0),
        ("exit", Status.FAILED, "exit code 3; it last said: a is 7.1", 400),  # its output is kept and not believed
        ("hang", Status.TIMED_OUT, "no answer within 1 s", 0),
        ("signal", Status.FAILED, "killed by signal 15 (SIGTERM)", 400),
    ],
)
def test_what_programs_do_wrong(program, tmp_path, kind, status, words, rows):
    found = program(kind, time_limit=1.0 if kind == "hang" else 60.0).simulate(STIFFNESS, RECORD)
    assert found.status[0] == status
    assert words in found.reasons[0]
    assert np.isfinite(found.values[0, :, 0]).sum() == rows
    assert len(list((tmp_path / "scratch").iterdir())) == 1  # kept, to look into
    if kind not in ("hang", "nan", "short", "torn"):
        assert str(tmp_path / "scratch") in found.reasons[0]


def test_scratch_folders_of_good_runs_go(program, tmp_path):
    assert program().simulate(np.repeat(STIFFNESS, 3, axis=0), RECORD).done.all()
    assert not list((tmp_path / "scratch").iterdir())


def test_histories_at_the_programs_own_times_are_brought_to_the_samples(program, tmp_path):
    """The program writes every 0.01 s; a record at 0.004 s needs rows between."""
    fine = si.GroundMotion(np.zeros(501), 0.004)
    (tmp_path / "input.j2").write_text("1.0 201")
    model = program(output=si.OutputFile("out.csv", {"velocity": "velocity"}, time="time"))
    np.testing.assert_allclose(model.simulate(STIFFNESS, fine).values[0, :, 0], fine.time / 0.01, atol=1e-9)
    longer = model.simulate(STIFFNESS, si.GroundMotion(np.zeros(601), 0.004))
    assert longer.status[0] == Status.FAILED and "501 rows" in longer.reasons[0]


def test_hdf5_output(tmp_path):
    (tmp_path / "solver.py").write_text(
        "import h5py, numpy as np\nwith h5py.File('o.h5', 'w') as f: f['nodes/44'] = np.loadtxt('record.txt')"
    )
    output = si.OutputFile("o.h5", {"velocity": "nodes/44"})
    model = si.ProgramModel(
        f"{sys.executable} {{{{ folder }}}}/solver.py", ("a",), output, record_file="record.txt", folder=tmp_path
    )
    np.testing.assert_array_equal(model.simulate(np.ones((1, 1)), RECORD).values[0, :, 0], RECORD.values)


def test_a_program_that_is_not_there():
    model = si.ProgramModel("no_such_program", ("a",), si.OutputFile("o.csv", {"v": 0}), keep="none")
    found = model.simulate(np.ones((1, 1)), RECORD)
    assert found.status[0] == Status.FAILED and "'no_such_program' could not be started" in found.reasons[0]


def test_templates_are_checked_at_the_door(program, tmp_path):
    (tmp_path / "input.j2").write_text("{{ stifness }}")
    with pytest.raises(InputError, match=r"'stifness' is undefined.*stiffness, record"):
        program()
    (tmp_path / "input.j2").write_text("{{ stiffness ")
    with pytest.raises(InputError, match="jinja2"):
        program()
    (tmp_path / "input.j2").unlink()
    with pytest.raises(InputError, match="no such file"):
        program()


def test_the_hash_knows_templates_and_the_program_itself(program, tmp_path):
    before = program().content_hash
    assert program().content_hash == before
    (tmp_path / "input.j2").write_text("1 {{ record.samples }}")
    changed = program().content_hash
    (tmp_path / "solver.py").write_text(PROGRAM + "\n# another version")
    assert len({before, changed, program().content_hash}) == 3


# --- UM-Bridge ------------------------------------------------------------------------------------------------------

OFFICIAL_SERVER = """
import sys, math, umbridge
class Wave(umbridge.Model):
    def __init__(self): super().__init__("wave")
    def get_input_sizes(self, config): return [1, 1]
    def get_output_sizes(self, config): return [config.get("samples", 400)]
    def __call__(self, parameters, config):
        (a,), (b,) = parameters
        if a > 5: raise RuntimeError("too large")
        return [[a * math.sin(b * 0.01 * i) for i in range(config.get("samples", 400))]]
    def supports_evaluate(self): return True
umbridge.serve_models([Wave()], int(sys.argv[1]))
"""


def free_port():
    import socket

    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def served(arguments, port):
    umbridge = pytest.importorskip("umbridge")
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 90
    while True:
        try:
            return process, umbridge.supported_models(f"http://127.0.0.1:{port}")
        except Exception:
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.2)


def test_our_client_runs_a_server_written_with_the_official_package(tmp_path):
    script = tmp_path / "server.py"
    script.write_text(OFFICIAL_SERVER)
    port = free_port()
    process, names = served([sys.executable, str(script), str(port)], port)
    try:
        assert names == ["wave"]
        url = f"http://127.0.0.1:{port}"
        model = si.UMBridgeModel(url, ("a", "b"), ("velocity",), "wave", time_limit=20.0)
        theta = np.array([[1.5, 2.0], [9.0, 2.0], [0.5, 3.0]])
        found = model.simulate(theta, RECORD)
        np.testing.assert_allclose(found.values[0, :, 0], 1.5 * np.sin(2.0 * RECORD.time), rtol=1e-14)
        assert found.status.tolist() == [Status.DONE, Status.FAILED, Status.DONE]
        assert "did not answer" in found.reasons[1]
        wrong = si.UMBridgeModel(url, ("a",), ("velocity",), "wave").simulate(theta[:1, :1], RECORD)
        assert "takes 2 numbers, there are 1 parameters" in wrong.reasons[0]
        short = si.UMBridgeModel(url, ("a", "b"), ("velocity",), "wave", {"samples": 300}).simulate(theta[:1], RECORD)
        assert "300 rows" in short.reasons[0]
        nobody = si.UMBridgeModel(url, ("a", "b"), ("velocity",), "ripple").simulate(theta[:1], RECORD)
        assert "ripple" in nobody.reasons[0]
    finally:
        process.kill()
        process.wait()


def test_the_official_client_reads_our_server(tmp_path, study_space):

    study = tmp_path / "study.toml"
    study.write_text(shortened(PLAIN, "9 s"))
    port = free_port()
    command = [sys.executable, "-c", "from structid.cli import main; main()", "serve", str(study), "--port", str(port)]
    process, names = served(command, port)
    try:
        import umbridge

        from structid.study.run import load

        built = load(study)
        assert names == ["forward", "posterior"]
        forward = umbridge.HTTPModel(f"http://127.0.0.1:{port}", "forward")
        assert forward.get_input_sizes() == [4] and forward.get_output_sizes() == [601]
        theta = built.space.sample(1, seed=2).values
        (answer,) = forward(theta.tolist())
        expected = built.model.simulate(theta, built.record).values[0, :, 0]
        np.testing.assert_allclose(answer, expected, rtol=1e-12, atol=1e-15)
        short = {"record": {"dt": 0.01, "values": built.record.values[:200].tolist()}}
        np.testing.assert_allclose(forward(theta.tolist(), short)[0], expected[:200], rtol=1e-9, atol=1e-12)
        # Derivatives through the protocol against differences through the protocol.
        direction = [theta[0, 0] * 1e-6, 0.0, 0.0, 0.0]
        step = np.array([direction])
        difference = (np.array(forward((theta + step).tolist())[0]) - np.array(forward((theta - step).tolist())[0])) / 2
        jacobian = np.array(forward.apply_jacobian(0, 0, theta.tolist(), direction))
        # A difference across a kink of the law (the velocity changes sign within a step) is of first order only.
        np.testing.assert_allclose(jacobian, difference, atol=1e-3 * np.abs(jacobian).max())
        weights = np.linspace(-1.0, 1.0, 601).tolist()
        gradient = forward.gradient(0, 0, theta.tolist(), weights)
        assert np.dot(gradient, direction) == pytest.approx(np.dot(weights, jacobian), rel=1e-8)
        density = umbridge.HTTPModel(f"http://127.0.0.1:{port}", "posterior")
        phi = built.posterior.space.sample(1, seed=3).values
        assert density(phi.tolist())[0][0] == pytest.approx(built.posterior.log_density(phi)[0], rel=1e-10)
        phi[0, 0] = -1.0
        assert density(phi.tolist())[0][0] < -1e300
    finally:
        process.kill()
        process.wait()


def test_a_run_that_fails_is_too_short_for_the_protocol():
    model = si.CallableModel(solvers.misbehaving, ("a",), ("velocity",), isolated=False)
    served_model = ServedModel(model, RECORD)
    assert [len(v) for v in served_model([[2.0]], {})] == [100]
    assert served_model.get_output_sizes({}) == [400]
    assert not served_model.supports_gradient()


def test_a_packed_call_does_its_work_wherever_it_is_unpickled():
    import pickle

    model = si.CallableModel(solvers.wave, ("a", "b"), ("velocity",))
    task = model.task(np.array([1.0, 2.0]), RECORD)
    call = pickle.loads(pickle.dumps(packed(model, RECORD)))
    np.testing.assert_array_equal(attempt(call, task).values[:, 0], solvers.wave(task.parameters, RECORD))
    assert os.getpid()  # this process is none the worse


# --- what a review found --------------------------------------------------------------------------------------------


def test_a_program_that_hangs_has_said_something(tmp_path):
    (tmp_path / "my solver").mkdir()
    (tmp_path / "my solver" / "hang.py").write_text("print('step 17', flush=True)\nimport time; time.sleep(60)")
    settings = dict(folder=tmp_path / "my solver", scratch=tmp_path / "scratch", time_limit=1.0)
    command = f"{sys.executable} {{{{ folder }}}}/hang.py"
    found = si.ProgramModel(command, ("a",), si.OutputFile("o", {"v": 0}), **settings).simulate(np.ones((1, 1)), RECORD)
    assert found.reasons[0].startswith("no answer within 1 s; it last said: step 17 [kept: ")
    tidy = si.ProgramModel(command, ("a",), si.OutputFile("o", {"v": 0}), keep="none", **settings)
    left = len(list((tmp_path / "scratch").iterdir()))
    assert "step 17" in tidy.simulate(np.ones((1, 1)), RECORD).reasons[0]
    assert len(list((tmp_path / "scratch").iterdir())) == left


def test_repeated_points_have_a_folder_each(program):
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(2) as pool:
        assert program().simulate(np.repeat(STIFFNESS, 8, axis=0), RECORD, map=pool.map).done.all()


def test_comments_and_fortran_numbers_in_a_programs_output(tmp_path):
    (tmp_path / "o.py").write_text(
        "open('o.txt', 'w').write('# 400 3\\n# t v\\n' + ''.join(f'{i} {i}.5D-01\\n' for i in range(400)))"
    )
    output = si.OutputFile("o.txt", {"velocity": "v"})
    model = si.ProgramModel(f"{sys.executable} {{{{ folder }}}}/o.py", ("a",), output, folder=tmp_path)
    np.testing.assert_allclose(model.simulate(np.ones((1, 1)), RECORD).values[0, :, 0], 0.1 * np.arange(400) + 0.05)


def test_a_unit_that_measures_something_else_is_refused():
    with pytest.raises(InputError, match=r"column 'velocity'.*kN"):
        si.OutputFile("o", {"velocity": 0}, {"velocity": "kN"})
