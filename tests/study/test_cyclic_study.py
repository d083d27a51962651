"""The study of a cyclic test: from a file to the page, continued, rewritten, and with mistakes in it."""

import re

import numpy as np
import pytest

import structid as si
from commands import structid
from law_paths import path_between

STUDY = """
name = "wall"

[cyclic_test]
file = "../data/wall.csv"
displacement_column = "top"
displacement_unit = "mm"
force_column = "force"
force_unit = "kN"

[model]
type = "hysteretic"
law = ["elastic_plastic", "bilinear"]

[[prediction]]
name = "twice the test"
scale = 2.0

[[prediction]]
name = "a push"
file = "../data/push.csv"
unit = "mm"

[dynamics]
mass = "12 t"
damping_ratio = "2 %"
draws = 40

[[dynamics.records]]
synthetic = { seed = 8 }
name = "a record"
trim = [3, 8]
pga = "0.3 g"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the study, and its data in a folder beside it."""
    folder = tmp_path_factory.mktemp("laboratory")
    (folder / "data").mkdir()
    (folder / "study").mkdir()
    path = 1e-3 * path_between(np.array([2, -2, 4, -4, 8, -8, 12, -12, 16, -16, 0.0]), 20)
    law = {"stiffness": "20 kN/mm", "yield_force": "60 kN", "hardening": 0.1}
    force = si.Hysteretic("bilinear", law).simulate(np.zeros((1, 0)), si.DisplacementHistory(path, 1.0)).values[0, :, 0]
    force = force + 0.02 * np.abs(force).max() * np.random.default_rng(0).normal(size=len(force))
    lines = [f"{k},{1e3 * u:.4f},{1e-3 * f:.3f}" for k, (u, f) in enumerate(zip(path, force, strict=True))]
    (folder / "data" / "wall.csv").write_text("\n".join(["line,top,force", *lines]))
    (folder / "data" / "push.csv").write_text("\n".join(f"{x:.3f}" for x in np.linspace(0.0, 20.0, 40)))
    (folder / "study" / "wall.toml").write_text(STUDY)
    return folder / "study"


@pytest.fixture(scope="module")
def run(folder):
    return structid("run", "wall.toml", cwd=folder)


def test_the_law_is_chosen_and_the_page_written(folder, run):
    assert run.returncode == 0, run.stderr + run.stdout
    assert "The test chooses the bilinear" in run.stdout
    page = (folder / "wall" / "report.html").read_text()
    for key in ("loops", "laws", "cycles", "held-out", "parameters", "paths", "dynamics"):
        assert f'<h2 id="{key}">' in page
    assert "a push" in page and "twice the test" in page and "a record" in page
    assert re.search(r"The 90 % band holds \d+% of", page)
    assert (folder / "wall" / "posterior.nc").is_file()


def test_input_files_are_copied_into_the_folder(folder, run):
    """Names with .. stay inside the folder of the results."""
    kept = sorted(path.name for path in (folder / "wall" / "inputs").rglob("*.csv"))
    assert kept == ["push.csv", "wall.csv"]


def test_the_page_is_written_again_without_the_data(folder, run, tmp_path):
    import shutil

    copy = tmp_path / "moved"
    shutil.copytree(folder / "wall", copy)
    before = (copy / "report.html").read_text()
    again = structid("report", "moved", cwd=tmp_path)
    assert again.returncode == 0, again.stderr + again.stdout
    after = (copy / "report.html").read_text()
    assert _tables(after) == _tables(before)


def _tables(page):
    return re.findall(r"<td>(.*?)</td>", page.split("Settings, versions, timings")[-2])


def test_a_second_run_needs_resume(folder, run):
    refused = structid("run", "wall.toml", cwd=folder)
    assert refused.returncode == 2 and "--resume" in refused.stderr
    assert structid("run", "wall.toml", "--resume", cwd=folder).returncode == 0


def test_check_prints_the_test_and_its_quantities(folder):
    printed = structid("check", "wall.toml", cwd=folder)
    assert printed.returncode == 0, printed.stderr
    assert "half-cycles" in printed.stdout and "12 t = 12000 kg" in printed.stdout


def test_the_template_of_a_new_study_names_what_is_missing(tmp_path):
    assert structid("new", "mine", "--like", "cyclic", cwd=tmp_path).returncode == 0
    refused = structid("check", "mine.toml", cwd=tmp_path)
    assert refused.returncode == 2 and "MY_TEST.csv" in refused.stderr


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('law = ["elastic_plastic", "bilinear"]', 'law = "bilinaer"', "Did you mean 'bilinear'"),
        ('displacement_unit = "mm"', 'displacement_unit = "kN"', "displacement_unit|kN"),
        ('displacement_column = "top"', 'displacement_column = "tip"', "tip"),
        ("scale = 2.0", "", "neither file nor scale"),
        ('mass = "12 t"', 'mass = "0 t"', "dynamics.mass"),
        ('unit = "mm"\n\n[dynamics]', "\n[dynamics]", "a file without a unit"),
        ("[model]", "[modle]", "modle"),
        ('name = "a push"', 'name = "twice the test"', "different names"),
    ],
)
def test_a_mistake_is_named(folder, tmp_path, old, new, said):
    assert old in STUDY
    (folder / "wrong.toml").write_text(STUDY.replace(old, new, 1))
    refused = structid("check", "wrong.toml", cwd=folder)
    assert refused.returncode == 2, refused.stdout
    assert re.search(said, refused.stderr), refused.stderr
    assert "Traceback" not in refused.stderr


def test_lines_without_numbers_are_left_out_if_asked(folder, tmp_path):
    lines = (folder.parent / "data" / "wall.csv").read_text().splitlines()
    lines[5] = "4,,12.0"
    (tmp_path / "gap.csv").write_text("\n".join(lines))
    settings = {"displacement_unit": "mm", "force_unit": "kN", "displacement_column": "top", "force_column": "force"}
    with pytest.raises(si.InputError, match="leave_out"):
        si.CyclicTest.read(tmp_path / "gap.csv", **settings)
    test = si.CyclicTest.read(tmp_path / "gap.csv", **settings, missing="leave_out")
    assert len(test.force) == len(lines) - 2
