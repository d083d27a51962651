"""Studies of external solvers, from their words to runs, draws and pages; every mistake in them is one clear paragraph."""

import sys

import numpy as np
import pytest

import structid as si
from commands import structid
from structid.calibration.calibration_result import CalibrationResult
from structid.campaign.runs import Runs
from structid.core.errors import InputError, Status
from structid.study import packaged
from structid.study.run import load, report_again, run_study
from studies import PLAIN, without_pages

SOLVER = packaged.SOLVERS["external"]
TEMPLATE = packaged.template("external").replace('trim = ["3 s", "11 s"]', 'trim = ["3 s", "4 s"]')
RUNS_ONLY = TEMPLATE[: TEMPLATE.index("[observation]")] + ('[campaign]\nruns = 12\nmethod = "sobol"\nattempts = 2\n\n')
STUDY = (
    RUNS_ONLY
    + TEMPLATE[TEMPLATE.index("[observation]") : TEMPLATE.index("[surrogate]")]
    + ('[sampler]\nkind = "aies"\nwalkers = 8\nensembles = 2\nsteps = 20\nstart_candidates = 1\nsettling_steps = 0\n')
)
"""A campaign, and a sampler that runs the solver itself."""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / SOLVER).write_text(packaged.template(SOLVER))
    (tmp_path / "study.toml").write_text(STUDY)
    (tmp_path / "runs.toml").write_text(RUNS_ONLY)
    return tmp_path


@pytest.mark.slow
def test_runs_then_a_calibration_then_the_page_again(folder):
    (folder / "study.toml").write_text(STUDY.replace("steps = 20", "steps = 8"))
    outcome = run_study(folder / "study.toml", folder / "out", executor="processes:2")
    assert outcome.results[Runs].done.all() and len(outcome.results[Runs]) == 12
    assert outcome.result.draws.shape[-1] == 4
    page = outcome.report.read_text()
    assert "Model runs" in page and "Status of the runs" in page
    with without_pages():
        serial = run_study(folder / "study.toml", folder / "again")
    np.testing.assert_array_equal(serial.result.history, outcome.result.history)
    np.testing.assert_array_equal(serial.results[Runs].values, outcome.results[Runs].values)
    assert report_again(folder / "out").report.read_text().count("<figure>") == page.count("<figure>")


@pytest.mark.rendered
def test_a_study_of_runs_alone(folder):
    done = structid("run", "runs.toml", "--out", "out", "--executor", "processes:2", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "12 runs on 1 record" in done.stdout and "12 done" in done.stdout
    page = (folder / "out" / "report.html").read_text()
    assert "All 12 runs are done" in page and page.count("<figure>") == 1
    told = structid("runs", "out", cwd=folder)
    assert (
        told.returncode == 0
        and "12 done" in told.stdout
        and "s per run (median)" in told.stdout
        and "runs/s over the last 12" in told.stdout
    )
    again = structid("report", "out", cwd=folder)
    assert again.returncode == 0, again.stderr


def test_failed_runs_are_shown_and_tried_again(folder):
    solver = (folder / SOLVER).read_text()
    broken = solver.replace(
        '    stiffness = parameters["stiffness"]',
        '    import pathlib\n    if parameters["hardening"] > 0.25 and not pathlib.Path(__file__).with_name("licence").exists():\n'
        '        raise OSError("no licence")\n    stiffness = parameters["stiffness"]',
    )
    (folder / SOLVER).write_text(broken)
    done = structid("run", "runs.toml", "--out", "out", cwd=folder)
    assert done.returncode == 0
    assert "6 done, 6 failed" in done.stdout and "6 x OSError: no licence" in done.stdout
    told = structid("runs", "out", "--failed", cwd=folder)
    assert told.stdout.count("(attempt 2): failed: OSError: no licence") == 6
    assert told.stdout.count("kN/mm") == 6 and "hardening 0.2" in told.stdout
    assert "6 of 12 runs are done" in (folder / "out" / "report.html").read_text()
    (folder / "licence").touch()
    again = structid("run", "runs.toml", "--out", "out", "--retry", cwd=folder)
    assert again.returncode == 0, again.stderr
    runs = si.open_runs(folder / "out" / "runs.h5")
    assert runs.done.all() and sorted(runs.attempts) == [1] * 6 + [3] * 6


def test_a_built_in_model_with_a_campaign_on_two_records(tmp_path):
    text = PLAIN
    text = text[: text.index("[observation]")].replace(
        'lowpass = "20 Hz"', 'lowpass = "20 Hz"\ntrim = ["3 s", "5 s"]', 1
    )
    text += '[campaign]\nruns = 9\nchannels = ["velocity", "displacement"]\nmethod = "maximin"\n'
    text += '[[campaign.records]]\nname = "other"\nsynthetic = { seed = 3, duration = 5 }\n'
    (tmp_path / "s.toml").write_text(text)
    runs = run_study(tmp_path / "s.toml", tmp_path / "out").results[Runs]
    assert runs.channels == ("velocity", "displacement") and runs.done.all()
    assert [len(runs.on(i)) for i in (0, 1)] == [5, 4] and runs.records[1].name == "other"


CHANGES = {
    "no such file": ('source = "external_solver.py"', 'source = "solver.py"', ["model.source", "no file", "solver.py"]),
    "no such function": ('function = "respond"', 'function = "respnd"', ["model.function", "Did you mean 'respond'"]),
    "a misspelt key": ('time_limit = "20 s"', 'time_limt = "20 s"', ["model.time_limt", "Did you mean 'time_limit'"]),
    "a limit of nothing": ('time_limit = "20 s"', 'time_limit = "0 s"', ["model.time_limit"]),
    "no channels": (
        'channels = ["velocity"]         # channels that the function returns\n',
        "",
        ["model.channels", "missing"],
    ),
    "another unit": ('time_limit = "20 s"', 'time_limit = "20 m"', ["model.time_limit", "20 m"]),
    "no runs": ("runs = 12", "runs = 0", ["campaign.runs"]),
    "an unknown design": ('method = "sobol"', 'method = "grid"', ["campaign.method", "grid", "sobol"]),
    "a parameter it does not have": (
        'function = "respond" ',
        'parameters = ["stifness"]\nfunction = "respond" ',
        ["model.parameters", "Did you mean 'stiffness'"],
    ),
    "derivatives it does not have": (
        "[sampler]",
        '[deterministic]\nmethods = ["interior_point"]\n[sampler]',
        ["deterministic.methods", "no derivatives", "pattern_search"],
    ),
    "an unknown kind": ('type = "python"', 'type = "pyhton"', ["model", "pyhton", "'program'"]),
}


@pytest.mark.parametrize("case", CHANGES)
def test_a_wrong_study_says_what_and_where(case, folder):
    old, new, words = CHANGES[case]
    assert old in STUDY
    (folder / "study.toml").write_text(STUDY.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        run_study(folder / "study.toml", folder / "out")
    message = str(error.value)
    assert all(word in message for word in words), message
    assert not (folder / "out").exists()


def test_a_solver_that_cannot_be_imported(folder):
    (folder / SOLVER).write_text("import no_such_library")
    with pytest.raises(InputError, match=r"cannot be imported: ModuleNotFoundError.*no_such_library"):
        load(folder / "study.toml")


def test_neither_measured_nor_run(folder):
    text = RUNS_ONLY[: RUNS_ONLY.index("[campaign]")]
    (folder / "nothing.toml").write_text(text)
    with pytest.raises(InputError, match=r"neither an \[observation\] nor a \[campaign\]"):
        load(folder / "nothing.toml")


def test_a_changed_solver_is_another_study(folder):
    run_study(folder / "runs.toml", folder / "out")
    (folder / SOLVER).write_text(packaged.template(SOLVER).replace("0.03", "0.05"))
    # The file is imported once in a process, so the change is seen by the next one.
    refused = structid("run", "runs.toml", "--out", "out", "--resume", cwd=folder)
    assert refused.returncode == 2 and "belongs to another study" in refused.stderr


def test_a_program_in_a_study(folder):
    (folder / "solver.py").write_text(
        "import sys, numpy as np\nk, dt = map(float, sys.argv[1:3])\na = np.loadtxt('record.txt')\n"
        "np.savetxt('out.txt', np.column_stack([np.arange(len(a)) * dt, a * k]), header='time velocity')\n"
    )
    text = RUNS_ONLY.replace(
        RUNS_ONLY[RUNS_ONLY.index('type = "python"') : RUNS_ONLY.index("[parameters.stiffness]")],
        f'type = "program"\ncommand = "{sys.executable} {{{{ folder }}}}/solver.py {{{{ stiffness | unit(\'kN/mm\') }}}} '
        '{{ record.dt }}"\nrecord_file = "record.txt"\n[model.output]\npath = "out.txt"\n'
        'columns = { velocity = "velocity" }\nunits = { velocity = "mm/s" }\ntime = 0\n\n',
    )
    (folder / "program.toml").write_text(text)
    runs = run_study(folder / "program.toml", folder / "out", executor="processes").results[Runs]
    assert runs.counts[Status.DONE] == 12, runs.reasons
    expected = runs.design.values[3, 0] * 1e-6 * runs.records[0].values * 1e-3
    np.testing.assert_allclose(runs.values[3, :, 0], expected, rtol=1e-12, atol=1e-18)
    assert not list((folder / "out" / "scratch").iterdir())


def test_the_cost_of_an_external_study_is_told(folder):
    told = structid("check", "study.toml", cwd=folder)
    assert told.returncode == 0 and "with another run between" not in told.stdout, told.stderr
    assert "Campaign: 12 model runs one after another" in told.stdout and "--executor" in told.stdout
    assert "Sampling: 320 model runs" in told.stdout


def test_new_writes_the_solver_too_and_never_over_one(tmp_path):
    made = structid("new", "mine", "--like", "external", cwd=tmp_path)
    assert made.returncode == 0 and {p.name for p in tmp_path.iterdir()} == {"mine.toml", SOLVER}
    refused = structid("new", "second", "--like", "external", cwd=tmp_path)
    assert refused.returncode == 2 and SOLVER in refused.stderr and not (tmp_path / "second.toml").exists()


@pytest.mark.slow
def test_the_example_as_it_is_written_finds_its_truth(tmp_path):
    for name, template in (("study.toml", "external"), (SOLVER, SOLVER)):
        (tmp_path / name).write_text(packaged.template(template))
    with without_pages():
        outcome = run_study(tmp_path / "study.toml", tmp_path / "out")
    assert outcome.results[CalibrationResult].certificate.certified
    truth = np.array([7.6e6, 1.0 / 126.0, 0.05])  # of β = γ = 63/m
    assert (np.abs(outcome.result.mean[:3] - truth) < 3.0 * outcome.result.sd[:3]).all(), str(outcome.result)


def test_check_tries_the_solver(folder):
    (folder / SOLVER).write_text(packaged.template(SOLVER).replace("    damping = ", "    damping = undefined * "))
    told = structid("check", "study.toml", cwd=folder)
    assert told.returncode == 2
    assert "its trial run failed: NameError: name 'undefined' is not defined (external_solver.py, line" in told.stderr


def test_a_campaign_where_nothing_is_done_has_failed(folder):
    (folder / SOLVER).write_text("def respond(p, r):\n    raise OSError('no licence')\n")
    done = structid("run", "runs.toml", "--out", "out", cwd=folder)
    assert done.returncode == 1 and "No run has finished" in done.stderr
    assert (folder / "out" / "report.html").exists()


def test_more_runs_later_and_a_mended_solver(folder):
    (folder / "helpers.py").write_text("import functools\n@functools.cache\ndef factor():\n    return 1.0\n")
    (folder / SOLVER).write_text(
        "import helpers\ndef respond(p, r):\n    if p['hardening'] > 0.25:\n        raise ValueError('too hard')\n"
        "    return helpers.factor() * p['stiffness'] * r.values\n"
    )
    assert structid("run", "runs.toml", "--out", "out", "--executor", "processes:2", cwd=folder).returncode == 0
    (folder / "runs.toml").write_text(RUNS_ONLY.replace("runs = 12", "runs = 20"))
    more = structid("run", "runs.toml", "--out", "out", "--resume", cwd=folder)
    assert more.returncode == 0 and "20 runs" in more.stdout, more.stderr
    (folder / "helpers.py").write_text("def factor():\n    return 2.0\n")
    refused = structid("run", "runs.toml", "--out", "out", "--retry", cwd=folder)
    assert refused.returncode == 2 and "model is" in refused.stderr and "--adopt" in refused.stderr
    assert structid("report", "out", cwd=folder).returncode == 0  # it needs the runs alone
    (folder / SOLVER).write_text(
        "import helpers  # mended\ndef respond(p, r):\n    return helpers.factor() * p['stiffness'] * r.values\n"
    )
    done = structid("run", "runs.toml", "--out", "out", "--retry", "--adopt", cwd=folder)
    assert done.returncode == 0 and "20 done" in done.stdout, done.stderr


def test_an_executor_that_is_not_there_takes_no_folder(folder):
    refused = structid("run", "runs.toml", "--out", "out", "--executor", "processes:0", cwd=folder)
    assert refused.returncode == 2 and not (folder / "out").exists()


def test_a_server_in_a_study_that_does_not_answer(folder):
    pytest.importorskip("umbridge")
    start, end = RUNS_ONLY.index('type = "python"'), RUNS_ONLY.index("[parameters.stiffness]")
    section = 'type = "umbridge"\nurl = "http://127.0.0.1:9"\nmodel = "wave"\nchannels = ["velocity"]\n\n'
    (folder / "served.toml").write_text(RUNS_ONLY[:start] + section + RUNS_ONLY[end:])
    runs = run_study(folder / "served.toml", folder / "out").results[Runs]
    assert runs.counts[Status.FAILED] == 12 and "the server at http://127.0.0.1:9 did not answer" in runs.reasons[0]


def test_a_solver_that_remembers_the_run_before(folder):
    """The first run is at the medians, and so is the third: what the second has left behind shows."""
    text = (folder / SOLVER).read_text()
    assert "    return velocities\n" in text
    (folder / SOLVER).write_text(
        text.replace(
            "    return velocities\n",
            "    count = Path(__file__).with_name('count')\n"
            "    runs = len(count.read_text()) if count.exists() else 0\n"
            "    count.write_text('x' * (runs + 1))\n"
            "    return [(1.0 + 0.01 * runs) * velocity for velocity in velocities]\n",
        ).replace("from itertools", "from pathlib import Path\nfrom itertools")
    )
    done = structid("check", "study.toml", cwd=folder)
    assert done.returncode == 2 and "with another run between them, differ by" in done.stdout, done.stdout
