"""A study through the command line: run, resumed, reported again; mistakes exit with 2 and leave nothing behind."""

import json
import re
import shutil

import numpy as np
import pytest

from commands import structid
from structid.core.errors import StoreMismatchError
from structid.study import packaged
from structid.study.folder import left_as_it_was
from structid.study.folder_layout import IDENTITY, STUDY
from structid.study.run import load, report_again, run_study
from studies import SMALL, without_pages

FIGURES = {
    "record",
    "processing",
    "measurement",
    "response_velocity",
    "loops",
    "energy",
    "marginals",
    "pairs",
    "identifiability",
    "residuals_velocity",
    "traces",
    "acceptance",
    "identified",
    "other_1_velocity",
}
"""Of its page."""


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def test_mistakes_of_several_parts_are_told_together(tmp_path):
    """What needs no other part to be seen: a prior, the sampler, a calibration's budget, a table that is missing."""
    text = SMALL.replace("low = 4.27", "low = 12").replace("[sampler]", "[calibration]\ntrue_runs = 35\n[sampler]")
    (tmp_path / "wrong.toml").write_text(text.replace("walkers = 12", "walkers = 12\nparticles = 5"))
    told = structid("check", "wrong.toml", cwd=tmp_path)
    assert told.returncode == 2 and len(told.stderr.strip().splitlines()) == 4
    for words in ("parameters.stiffness", "sampler.particles", "calibrate(true_runs)", "no kind of [surrogate]"):
        assert words in told.stderr


def test_files_that_are_missing_are_told_together(tmp_path):
    text = packaged.template("measured").replace("low = 30\n", "low = 3000\n")
    start, end = text.index("[model]"), text.index("[parameters")
    external = '[model]\ntype = "python"\nsource = "solver.py"\nfunction = "f"\nchannels = ["displacement"]\n\n'
    (tmp_path / "wrong.toml").write_text(text[:start] + external + text[end:])
    told = structid("check", "wrong.toml", cwd=tmp_path)
    assert told.returncode == 2 and "Traceback" not in told.stderr
    for words in ("MY_RECORD.AT2: there is no such file", "MY_TOP.csv: there is no such file", "no file", "solver.py"):
        assert words in told.stderr, words
    assert "parameters.beta" in told.stderr


def test_a_wrong_unit_shows_before_anything_is_run(tmp_path):
    record = load_small(tmp_path)
    text = re.sub(r"\[observation.virtual\].*?\[discrepancy\]", "[discrepancy]", SMALL, flags=re.S)
    text = text.replace('channels = ["velocity"]', 'channels = ["velocity"]\nfile = "v.csv"\nunit = "UNIT"')
    np.savetxt(tmp_path / "v.csv", np.column_stack([record.time, 100.0 * np.sin(20.0 * record.time)]), delimiter=",")
    (tmp_path / "right.toml").write_text(text.replace("UNIT", "mm/s"))
    (tmp_path / "wrong.toml").write_text(text.replace("UNIT", "m/s"))
    right, wrong = (structid("check", f"{n}.toml", cwd=tmp_path).stdout for n in ("right", "wrong"))
    assert "the measured velocity 100 mm/s (mainly at 3.2 Hz)." in right and "Are all units right" not in right
    assert "the measured velocity 1e+05 mm/s" in wrong and "Are all units right" in wrong


def test_check_says_what_room_a_calibration_has(tmp_path):
    (tmp_path / "tight.toml").write_text(packaged.template("bouc_wen").replace("true_runs = 500", "true_runs = 64"))
    told = structid("check", "tight.toml", cwd=tmp_path).stdout
    assert "allow 2 rounds of 10 runs" in told and "calibration.true_runs = 100" in told


def test_the_report_needs_only_its_folder(tmp_path):
    """The record and the measurement are kept beside the draws: the folder may move, the originals may go."""
    source = tmp_path / "source"
    source.mkdir()
    record = load_small(tmp_path)
    record.to_csv(source / "record.csv")
    np.savetxt(source / "v.csv", np.column_stack([record.time, 1e2 * np.sin(record.time)]), delimiter=",")
    text = re.sub(r"\[observation.virtual\].*?\[discrepancy\]", "[discrepancy]", SMALL, flags=re.S)
    text = text.replace('channels = ["velocity"]', 'channels = ["velocity"]\nfile = "v.csv"\nunit = "mm/s"')
    text = re.sub(r"\[record\].*?\[model\]", '[record]\nfile = "record.csv"\nunit = "m/s^2"\n[model]', text, flags=re.S)
    text = text.split("[[prediction.records]]")[0].replace('["pattern_search", "interior_point"]', "[]")
    (source / "m.toml").write_text(text)
    with without_pages():
        first = run_study(source / "m.toml", tmp_path / "out").result
    shutil.rmtree(source)
    (tmp_path / "out").rename(tmp_path / "moved")
    np.testing.assert_array_equal(report_again(tmp_path / "moved").result.history, first.history)


def load_small(tmp_path):
    (tmp_path / "s.toml").write_text(SMALL)
    return load(tmp_path / "s.toml").record


def test_run_report_resume_and_refusals(small, tmp_path):
    done = structid("run", small, "--out", "out", cwd=tmp_path)
    assert done.returncode == 3, done.stderr + done.stdout  # eighty steps do not converge, and it says so
    assert "NOT CONVERGED" in done.stdout and "Report:" in done.stdout and "stiffness [kN/mm]" in done.stdout
    out = tmp_path / "out"
    for name in (
        "report.html",
        "chains.h5",
        "posterior.nc",
        "study.toml",
        "pattern_search.txt",
        "interior_point.json",
        "timings.json",
    ):
        assert (out / name).stat().st_size > 0
    assert {p.stem for p in (out / "figures").glob("*.svg")} == FIGURES
    page = (out / "report.html").read_text()
    assert page.count('src="data:image/svg+xml;base64,') == len(FIGURES)
    assert "Not converged" in page and "http://" not in page.replace("http://www.w3.org", "")
    for part in ("R-hat", "Minima", "MAP", "versions", "Study file", "identifiability".capitalize()):
        assert part in page

    again = structid("run", small, "--out", "out", cwd=tmp_path)
    assert again.returncode == 2 and "--resume" in again.stderr and "Traceback" not in again.stderr
    chains = (out / "chains.h5").read_bytes()
    with without_pages():
        resumed = structid("run", small, "--out", "out", "--resume", cwd=tmp_path)
    assert resumed.returncode == 3
    assert (out / "chains.h5").read_bytes() == chains
    assert resumed.stdout.split("mean")[1] == done.stdout.split("mean")[1]

    (tmp_path / "other.toml").write_text(SMALL.replace("seed = 1\n", "seed = 2\n", 1))
    other = structid("run", "other.toml", "--out", "out", "--resume", cwd=tmp_path)
    assert other.returncode == 2 and "another study" in other.stderr
    assert (out / "chains.h5").read_bytes() == chains

    (out / "report.html").unlink()
    report = structid("report", "out", cwd=tmp_path)
    assert report.returncode == 3 and (out / "report.html").exists()
    assert json.loads((out / "timings.json").read_text())["pattern search"] > 0


@pytest.mark.slow
@pytest.mark.rendered
def test_every_figure_of_a_page_is_made_into_a_picture(small, tmp_path):
    run_study(small, tmp_path / "out")
    for name in FIGURES:
        picture = (tmp_path / "out" / "figures" / f"{name}.svg").read_text()
        assert len(picture) > 5_000 and picture.count("<path") > 10, name


def test_check_says_the_cost_and_new_writes_a_study(small, tmp_path):
    checked = structid("check", small, cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    assert "model runs" in checked.stdout and "in order" in checked.stdout and "Normal" in checked.stdout
    made = structid("new", "mine", "--like", "shear_frame", cwd=tmp_path)
    assert made.returncode == 0 and 'name = "mine"' in (tmp_path / "mine.toml").read_text()
    twice = structid("new", "mine", cwd=tmp_path)
    assert twice.returncode == 2 and "already exists" in twice.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["check", "nowhere.toml"], "the file does not exist"),
        (["report", "."], "no finished study"),
        (["run", "nowhere.toml", "--out", "o"], "the file does not exist"),
        (["run"], "Missing argument"),
        (["fly"], "fly"),
        (["new", "nodir/x"], "nodir"),
        (["new", "x", "--like", "bouc_when"], "Did you mean 'bouc_wen'"),
    ],
)
def test_mistakes_on_the_command_line_exit_with_2(arguments, words, tmp_path):
    done = structid(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr and "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_something_else_is_left_alone(small, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("precious")
    done = structid("run", small, "--out", "mine", cwd=tmp_path)
    assert done.returncode == 2 and "not empty" in done.stderr
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["thesis.txt"]


def test_a_folder_whose_stores_refuse_is_left_as_it_was(tmp_path):
    for name in (IDENTITY, STUDY):
        (tmp_path / name).write_text("before")
    with pytest.raises(StoreMismatchError), left_as_it_was(tmp_path):
        (tmp_path / IDENTITY).write_text("after")
        raise StoreMismatchError("store", "of another study", "this one")
    assert (tmp_path / IDENTITY).read_text() == (tmp_path / STUDY).read_text() == "before"
    with left_as_it_was(tmp_path):
        (tmp_path / IDENTITY).write_text("after")
    assert (tmp_path / IDENTITY).read_text() == "after"
