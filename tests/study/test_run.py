"""Study files and the command line: every mistake is one clear paragraph and exit code 2, and nothing is half-written."""

import json
import re
import shutil
import tomllib

import numpy as np
import pytest

import structid as si
from commands import structid
from structid import cli
from structid.errors import InputError
from structid.study.build import build
from structid.study.run import load, report_again, run_study
from structid.study.schema import StudyErrors, parse_study
from studies import PLAIN

SMALL = (
    PLAIN.replace('lowpass = "20 Hz"', 'lowpass = "20 Hz"\ntrim = ["3 s", "9 s"]', 1)
    .replace("steps = 3000", "steps = 80\nsettling_steps = 0\nstart_candidates = 2")
    .replace("walkers = 32", "walkers = 12")
    .replace("ensembles = 4", "ensembles = 2")
    .replace("starts = 4", "starts = 2")
)


@pytest.fixture
def small(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


@pytest.mark.parametrize("name", cli.TEMPLATES)
def test_every_packaged_study_builds(name, tmp_path):
    content = tomllib.loads(cli.template(name))
    if name in cli.SOLVERS:
        (tmp_path / cli.SOLVERS[name]).write_text(cli.template(cli.SOLVERS[name]))
    built = build(parse_study(content), tmp_path)
    assert np.isfinite(built.posterior.log_density(built.posterior.space.sample(2, seed=1).values)).all()


def test_units_become_si(small):
    built = load(small)
    assert built.posterior.model.mass == 12_000.0
    assert built.posterior.model.damping_ratio == 0.03
    assert built.record.pga == pytest.approx(1.8)
    assert built.truths[0].stiffness == 7.6e6
    assert built.posterior.space.marginals["stiffness"].support == (4.27e6, 11.85e6)


CHANGES = {
    "an unknown key, with the nearest known one": (
        'lowpass = "20 Hz"',
        'lowpas = "20 Hz"',
        ["record.lowpas", "Did you mean 'lowpass'"],
    ),
    "a unit of the wrong dimension": ('pga = "1.8 m/s^2"', 'pga = "1.8 kN"', ["record.pga", "1.8 kN", "m/s^2"]),
    "a prior upside down": ("low = 55\nhigh = 65", "low = 65\nhigh = 55", ["parameters.beta", "low < high"]),
    "a prior truncated to nothing": ("sd = 0.742", "sd = 0.1\n", None),
    "a parameter the model lacks": ("[parameters.beta]", "[parameters.betta]", ["betta", "Did you mean 'beta'"]),
    "no such record": ("synthetic = { seed = 8 }", 'file = "nowhere.AT2"', ["nowhere.AT2", "no such file"]),
    "two sources": ("synthetic = { seed = 8 }", 'synthetic = { seed = 8 }\nfile = "a.AT2"', ["record", "exactly one"]),
    "an unknown channel": ('channels = ["velocity"]', 'channels = ["speed"]', ["speed", "velocity"]),
    "an unknown model": ('type = "bouc_wen"\nmass', 'type = "bouc_when"\nmass', ["bouc_when"]),
    "a missing model": ('type = "bouc_wen"\nmass', "mass", ["model", "missing"]),
    "odd walkers": ("walkers = 12", "walkers = 13", ["walkers", "even"]),
    "no TOML": ("[record]", "[record", ["TOML", "line"]),
    "both a value and a prior": (
        'damping_ratio = "3 %"',
        'damping_ratio = "3 %"\nbeta = 60',
        ["parameters.beta", "[model]"],
    ),
    "a wrong unit of a prior": ('unit = "1/m"', 'unit = "kg"', ["parameters.beta", "kg"]),
    "a wrong unit of a nuisance": (
        "[observation.virtual]",
        '[observation.time_shift]\ndistribution = "normal"\nunit = "kg"\nmean = 0\nsd = 1\n[observation.virtual]',
        ["observation.time_shift", "kg"],
    ),
    "too few walkers": ("walkers = 12", "walkers = 8", ["sampler.walkers", "10 or more"]),
    "a constraint with a typo": ("starts = 2", 'starts = 2\nconstraints = ["gama_ratio <= beta"]', ["gama_ratio"]),
    "bounds of nothing": (
        "starts = 2",
        "starts = 2\nbounds = { betta = [1, 2] }",
        ["deterministic.bounds.betta", "Did you mean 'beta'"],
    ),
    "no starts": ("starts = 2", "starts = 0", ["deterministic.starts"]),
    "a negative seed": ("seed = 1\n", "seed = -1\n", ["seed", "-1"]),
    "a derived typo": (
        "[observation]\n",
        '[derived]\ndelta_nnu = "2 * beta"\n[observation]\n',
        ["derived.delta_nnu", "delta_nu"],
    ),
    "a name for nothing": (
        "[parameters.beta]",
        '[parameters.junk]\ndistribution = "uniform"\nlow = 0\nhigh = 1\n[parameters.beta]',
        ["parameters.junk"],
    ),
    "a shape with a length unit and n = 2": (
        'damping_ratio = "3 %"\n',
        'damping_ratio = "3 %"\nexponent = 2\nbeta = "63 1/m"\n',
        ["beta", "plain number"],
    ),
    "an unknown distribution": (
        'distribution = "normal"',
        'distribution = "norml"',
        ["parameters.stiffness.distribution", "norml"],
    ),
}


@pytest.mark.parametrize("case", CHANGES)
def test_a_wrong_study_says_what_and_where(case, tmp_path):
    old, new, words = CHANGES[case]
    assert old in SMALL
    text = SMALL.replace(old, new, 1)
    if words is None:
        text, words = (
            text.replace("low = 4.27\nhigh = 11.85", "low = 9.5\nhigh = 11.85"),
            ["parameters.stiffness", "holds", "0.1"],
        )
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(si.InputError) as error:
        run_study(path, tmp_path / "out")
    message = str(error.value)
    assert all(word in message for word in words), message
    assert not (tmp_path / "out").exists()


def test_settling_fits_a_short_run(tmp_path):
    path = tmp_path / "short.toml"
    path.write_text(SMALL.replace("settling_steps = 0\n", ""))
    assert load(path).sampler.settling_steps == 24


def test_everything_wrong_is_said_at_once(tmp_path):
    with pytest.raises(StudyErrors) as error:
        parse_study(
            tomllib.loads(
                SMALL.replace("lowpass =", "lowpas =").replace("walkers =", "walker =").replace('"12 t"', '"12 s"')
            )
        )
    assert len(error.value.problems) == 5  # two keys of two records, one of the sampler, two masses


def test_mistakes_of_several_parts_are_told_together(tmp_path):
    """What needs no other part to be seen: a prior, the sampler, a calibration's budget."""
    text = SMALL.replace("low = 4.27", "low = 12").replace("[sampler]", "[calibration]\ntrue_runs = 100\n[sampler]")
    (tmp_path / "wrong.toml").write_text(text.replace("walkers = 12", "walkers = 12\nparticles = 5"))
    told = structid("check", "wrong.toml", cwd=tmp_path)
    assert told.returncode == 2 and len(told.stderr.strip().splitlines()) == 3
    for words in ("parameters.stiffness", "sampler.particles", "calibrate(true_runs)"):
        assert words in told.stderr


def test_a_wrong_unit_shows_before_anything_is_run(tmp_path):
    record = load_small(tmp_path)
    text = re.sub(r"\[observation.virtual\].*?\[discrepancy\]", "[discrepancy]", SMALL, flags=re.S)
    text = text.replace('channels = ["velocity"]', 'channels = ["velocity"]\nfile = "v.csv"\nunit = "UNIT"')
    np.savetxt(tmp_path / "v.csv", np.column_stack([record.time, 100.0 * np.sin(20.0 * record.time)]), delimiter=",")
    (tmp_path / "right.toml").write_text(text.replace("UNIT", "mm/s"))
    (tmp_path / "wrong.toml").write_text(text.replace("UNIT", "m/s"))
    right, wrong = (structid("check", f"{n}.toml", cwd=tmp_path).stdout for n in ("right", "wrong"))
    assert "the measured one 100 mm/s (mainly at 3.2 Hz)." in right and "Are all units right?" not in right
    assert "the measured one 1e+05 mm/s" in wrong and "Are all units right?" in wrong


def test_check_says_what_room_a_calibration_has(tmp_path):
    (tmp_path / "tight.toml").write_text(cli.template("bouc_wen").replace("true_runs = 500", "true_runs = 340"))
    told = structid("check", "tight.toml", cwd=tmp_path).stdout
    assert "room for 1 x 40 more" in told and "calibration.true_runs = 460" in told


def test_a_measured_file_of_another_length_or_step(tmp_path):
    record = load_small(tmp_path)
    time = record.time
    text = re.sub(r"\[observation.virtual\].*?\[discrepancy\]", "[discrepancy]", SMALL, flags=re.S)
    text = text.replace('channels = ["velocity"]', 'channels = ["velocity"]\nfile = "v.csv"\nunit = "mm/s"')
    (tmp_path / "m.toml").write_text(text)
    np.savetxt(tmp_path / "v.csv", np.column_stack([time, np.sin(time)]), delimiter=",")
    assert np.allclose(load(tmp_path / "m.toml").posterior.observations[0].values[:, 0], np.sin(time) * 1e-3)
    np.savetxt(tmp_path / "v.csv", np.column_stack([time[:-1], np.sin(time[:-1])]), delimiter=",")
    with pytest.raises(si.InputError, match="600 samples, and the record has 601"):
        load(tmp_path / "m.toml")
    np.savetxt(tmp_path / "v.csv", np.column_stack([2 * time, np.sin(time)]), delimiter=",")
    with pytest.raises(si.InputError, match=r"time step of 0.02 s, and the record has 0.01"):
        load(tmp_path / "m.toml")


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
    first = run_study(source / "m.toml", tmp_path / "out").result
    shutil.rmtree(source)
    (tmp_path / "out").rename(tmp_path / "moved")
    np.testing.assert_array_equal(report_again(tmp_path / "moved").result.history, first.history)


def load_small(tmp_path):
    (tmp_path / "s.toml").write_text(SMALL)
    return load(tmp_path / "s.toml").record


# --- a whole run, through the command line ----------------------------------------------------------------------------


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
    figures = {p.stem for p in (out / "figures").glob("*.png")}
    assert figures == {
        "record", "processing", "measurement", "response_velocity", "loops", "energy", "marginals", "pairs", "identifiability",
        "residuals_velocity",
        "traces", "acceptance", "identified", "other_1_velocity",
    }  # fmt: skip
    assert figures == {p.stem for p in (out / "figures").glob("*.pdf")}
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") == len(figures)
    assert "Not converged" in page and "http://" not in page.replace("http://www.w3.org", "")
    for part in ("R-hat", "Minima", "MAP", "versions", "Study file", "identifiability".capitalize()):
        assert part in page

    again = structid("run", small, "--out", "out", cwd=tmp_path)
    assert again.returncode == 2 and "--resume" in again.stderr and "Traceback" not in again.stderr
    chains = (out / "chains.h5").read_bytes()
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
    assert report_again(out).result.seed == 1


def test_check_says_the_cost_and_new_writes_a_study(small, tmp_path):
    checked = structid("check", small, cwd=tmp_path)
    assert checked.returncode == 0, checked.stderr
    assert "model runs" in checked.stdout and "in order" in checked.stdout and "Normal" in checked.stdout
    made = structid("new", "mine", "--like", "shear_frame", cwd=tmp_path)
    assert made.returncode == 0 and 'name = "mine"' in (tmp_path / "mine.toml").read_text()
    twice = structid("new", "mine", cwd=tmp_path)
    assert twice.returncode == 2 and "exists already" in twice.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["check", "nowhere.toml"], "no such file"),
        (["report", "."], "no finished study"),
        (["run", "nowhere.toml", "--out", "o"], "no such file"),
        (["run", "nowhere.toml"], "--out"),
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


def test_the_page_on_study_files_names_every_key():
    from pathlib import Path

    from structid.study import schema

    page = (Path(__file__).parents[2] / "docs" / "study_files.md").read_text()
    sections = [s for s in vars(schema).values() if isinstance(s, type) and issubclass(s, schema.Section)]
    keys = {key for section in sections for key in section.model_fields} - {"type", "draws", "model"}
    missing = [key for key in sorted(keys) if not re.search(rf"\b{key}\b", page)]
    assert not missing


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ('kind = "ar1"\nper_channel = true', "discrepancy.per_channel.*ar1 does not know"),
        ('kind = "damped_cosine"\ndamping = 1.2', "discrepancy.*below 1"),
        ('kind = "matern32"\ncorrelation_time = "3 m"', "discrepancy.correlation_time"),
        ('kind = "ar2"', "discrepancy.kind.*ar1"),
    ],
)
def test_mistakes_in_the_law_of_the_errors(table, words, tmp_path):
    text = re.sub(r"\[discrepancy\]\nkind[^\n]*", "[discrepancy]\n" + table, SMALL)
    (tmp_path / "law.toml").write_text(text)
    with pytest.raises(InputError, match=words):
        load(tmp_path / "law.toml")


def test_a_correlated_law_by_one_word(tmp_path):
    text = re.sub(r"\[discrepancy\]\nkind[^\n]*", '[discrepancy]\nkind = "damped_cosine"\ndamping = 0.1', SMALL)
    (tmp_path / "law.toml").write_text(re.sub(r"walkers = \d+", "walkers = 20", text))
    posterior = load(tmp_path / "law.toml").sampled
    assert posterior.names[-3:] == ("sigma2", "sigma2_white", "frequency")
    assert np.isfinite(posterior.log_density(posterior.space.sample(4, seed=1).values)).any()
