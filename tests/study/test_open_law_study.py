"""A study whose hysteretic law is left to the data: from files to the page, continued, rewritten, and with mistakes."""

import re

import numpy as np
import pytest
import xarray as xr

import structid as si
from commands import structid

MASS, LAW = 10e3, {"stiffness": "1.6 kN/mm", "yield_force": "19 kN", "hardening": 0.05}
STUDY = """
name = "specimen on a table"

[record]
synthetic = { seed = 4, arias = 3.0 }
trim = [2, 12]

[[observation]]
file = "lvdt.csv"
channels = ["displacement"]
unit = "mm"

[[observation]]
file = "acceleration.csv"
channels = ["absolute_acceleration"]
unit = "g"

[model]
type = "hysteretic"
law = ["elastic_plastic", "bilinear"]
mass = "10 t"

[parameters]
damping_ratio = { distribution = "uniform", low = 0.0, high = 0.1 }

[discrepancy]
kind = "iid"

[sampler]
kind = "smc"
particles = 100
ensembles = 2
steps = 60

[deterministic]
methods = []
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the study and its two files."""
    folder = tmp_path_factory.mktemp("laboratory")
    record = si.GroundMotion.synthetic(seed=4, arias=3.0).trim(2.0, 12.0)
    channels = ("displacement", "absolute_acceleration")
    specimen = si.Hysteretic("bilinear", LAW, mass=MASS, damping_ratio=0.03, channels=channels)
    y = specimen.simulate(np.zeros((1, 0)), record).values[0]
    y = y + 0.02 * np.sqrt((y**2).mean(axis=0)) * np.random.default_rng(0).normal(size=y.shape)
    for name, values in (("lvdt", 1e3 * y[:, 0]), ("acceleration", y[:, 1] / 9.80665)):
        table = np.column_stack([record.time, values])
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header="time,value", comments="", fmt="%.7g")
    (folder / "study.toml").write_text(STUDY)
    return folder


@pytest.fixture(scope="module")
def finished(folder):
    """The finished study, and what it prints."""
    run = structid("run", "study.toml", "--out", "out", cwd=folder)
    assert run.returncode == 0, run.stderr
    return folder / "out", run.stdout


def test_the_law_is_chosen_and_calibrated(finished):
    out, printed = finished
    assert "The test chooses the bilinear spring with kinematic hardening" in printed
    assert "After 2 of 2 laws: the bilinear spring with kinematic hardening leaves 0.0" in printed
    assert "no evidence against it" in printed
    page = (out / "report.html").read_text()
    assert "Which hysteretic law?" in page
    assert "bilinear, independent errors (chosen)" in page
    draws = xr.open_datatree(out / "posterior.nc")["posterior"]
    assert float(draws["stiffness"].mean()) == pytest.approx(1.6e6, rel=0.02)
    assert float(draws["hardening"].mean()) == pytest.approx(0.05, rel=0.1)


@pytest.mark.slow
def test_a_continued_study_and_a_new_report_fit_nothing_again(finished, folder):
    out, printed = finished
    before = {path.name: path.stat().st_mtime_ns for path in out.glob("*.journal")}
    again = structid("run", "study.toml", "--out", "out", "--resume", cwd=folder)
    report = structid("report", "out", cwd=folder)
    assert again.returncode == report.returncode == 0, again.stderr + report.stderr
    assert {path.name: path.stat().st_mtime_ns for path in out.glob("*.journal")} == before
    table = re.search(r"bilinear, independent errors .*", printed).group()
    assert table in again.stdout


def test_check_says_what_stands_in_for_the_law(folder):
    checked = structid("check", "study.toml", cwd=folder)
    assert checked.returncode == 0, checked.stderr
    assert "The data choose the hysteretic law when the study runs." in checked.stdout
    assert "Choosing the hysteretic law: about" in checked.stdout


def test_commands_that_need_one_law_say_so(folder):
    """They would use the law that stands in for the chosen one."""
    for command in (
        ("sbc", "study.toml"),
        ("serve", "study.toml"),
        ("certify", "study.toml", "draws.csv", "--out", "c"),
    ):
        refused = structid(*command, cwd=folder)
        assert refused.returncode == 2
        assert "the name of a law" in " ".join((refused.stdout + refused.stderr).split())
        assert "Traceback" not in refused.stderr


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[sampler]", "[derived]\nstrength = 'damping_ratio'\n\n[sampler]", "which needs the parameters of one law"),
        ("[sampler]", "[campaign]\nruns = 20\n\n[sampler]", "which needs the parameters of one law"),
        ('["elastic_plastic", "bilinear"]', "[]", "an empty list"),
        ('mass = "10 t"', 'mass = "10 t"\ndamping_ratio = 0.02', "it also has a value in [model]"),
        ("damping_ratio = {", "dampin_ratio = {", "no law has a parameter 'dampin_ratio'"),
        ('mass = "10 t"\n', "", "no mass"),
        ('law = ["elastic_plastic", "bilinear"]', 'law = ["elastic_plastik"]', "elastic_plastic"),
    ],
)
def test_mistakes_get_one_message(folder, tmp_path, old, new, message):
    assert old in STUDY
    for name in ("lvdt.csv", "acceleration.csv"):
        (tmp_path / name).write_text((folder / name).read_text())
    (tmp_path / "study.toml").write_text(STUDY.replace(old, new))
    checked = structid("check", "study.toml", cwd=tmp_path)
    assert checked.returncode == 2
    assert message in " ".join((checked.stdout + checked.stderr).split())
    assert "Traceback" not in checked.stderr


@pytest.mark.slow
def test_a_specimen_without_yielding_is_linear():
    record = si.GroundMotion.synthetic(seed=4, arias=0.02).trim(2.0, 10.0)
    specimen = si.Hysteretic("bilinear", LAW, mass=MASS, damping_ratio=0.03, channels=("absolute_acceleration",))
    y = specimen.simulate(np.zeros((1, 0)), record).values[0]
    y = y + 0.02 * np.std(y) * np.random.default_rng(0).normal(size=y.shape)
    measured = si.Observation(record, y, channels=specimen.channels)
    test = si.MotionTest(measured, mass=MASS, own_priors={"damping_ratio": si.Uniform(0.0, 0.1)})
    choice = si.choose_model(test, ["linear", "elastic_plastic", "bilinear", "masing"])
    assert choice.chosen.law.word == "linear"
