"""Programs as models: input from a template, histories from a file, every way to fail a status and a reason."""

import sys

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError, Status

RECORD = si.GroundMotion(np.sin(np.arange(400) * 0.05), 0.01, "sine")


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
            [sys.executable, "{{ folder }}/solver.py", kind],
            ("stiffness",),
            output,
            {"input.txt": "input.j2"},
            folder=tmp_path,
            scratch=tmp_path / "scratch",
            **settings,
        )

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
        ("garbage", Status.FAILED, "line 101 of 'out.csv' is not numeric: 'Error: negative Jacobian'", 0),
        ("columns", Status.FAILED, "no column 'velocity'", 0),
        ("nothing", Status.FAILED, "the program wrote no 'out.csv'; its folder contains input.txt, output.txt", 0),
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
    with pytest.raises(InputError, match=r"'velocity'.*kN"):
        si.OutputFile("o", {"velocity": 0}, {"velocity": "kN"})
