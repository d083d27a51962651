"""Finished studies side by side, and studies checked by simulation."""

import json
import shutil

import numpy as np
import pytest

from structid.calibration import simulated_calibrations
from structid.cli.main import main as cli
from structid.core.errors import InputError
from structid.study.compare import compare_studies
from structid.study.run import run_study
from structid.study.simulated_replicas import check_by_simulation
from studies import PACKAGED, PLAIN, shortened, without_pages

QUICK = '[sampler]\nkind = "smc"\nparticles = 100\nsteps = 20\neffective_share = 0.5\ncorrelation = 0.5\n'


METHODS = ('methods = ["pattern_search", "interior_point"]\nstarts = 4', "methods = []")


DEGRADING = """[parameters.delta_eta]
distribution = "uniform"
low = 0
high = 20

[observation]"""


def plain(name, degrading=False, **changes):
    text = shortened(PLAIN, "6 s").replace(*METHODS).replace('name = "bouc_wen"', f'name = "{name}"')
    begin, end = text.index("\n[sampler]") + 1, text.index("\n[deterministic]") + 1
    text = text[:begin] + QUICK + "\n" + text[end:]
    return text.replace("[observation]", DEGRADING, 1) if degrading else text


@pytest.fixture(scope="module")
def studies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("studies")
    for name, degrading in (("simple", False), ("degrading", True)):
        (folder / f"{name}.toml").write_text(plain(name, degrading))
        with without_pages():
            run_study(folder / f"{name}.toml", folder / name)
    return folder


@pytest.mark.slow
@pytest.mark.rendered("predictions_velocity")
def test_the_study_that_degrades_wins_where_the_structure_does(studies):
    comparison, page = compare_studies([studies / "simple", studies / "degrading"], studies / "page")
    assert comparison.best.name == "degrading" and comparison.bayes_factor(comparison.classes[0])[0] < -100.0
    assert comparison.classes[0].left_out.less(comparison.classes[1].left_out)[0] < -100.0
    text = page.read_text()
    assert comparison.verdict in text.replace("&#39;", "'") and text.count("<figure>") == 2
    for name in ("predictions_velocity", "other_1_velocity"):
        assert "<path" in (studies / "page" / "figures" / f"{name}.svg").read_text()
    # The structure of a virtual experiment is known, and stands beside what is predicted of it.
    assert "truth of the virtual experiment" in text and "true history inside" in text


def test_on_the_command_line(studies, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["structid", "compare", str(studies / "simple"), str(studies / "degrading")])
    with pytest.raises(SystemExit):
        cli()
    said = capsys.readouterr().out
    assert "log Bayes factor" in said and "degrading" in said and "unexplained" in said


def test_what_cannot_be_compared(studies, tmp_path):
    with pytest.raises(InputError, match="two or more"):
        compare_studies([studies / "simple"])
    with pytest.raises(InputError, match="contains no study"):
        compare_studies([studies / "simple", tmp_path])
    shutil.copytree(studies / "simple", tmp_path / "other")
    told = json.loads((tmp_path / "other" / "identity.json").read_text())
    told["study"]["observation"] = "another"
    (tmp_path / "other" / "identity.json").write_text(json.dumps(told))
    with pytest.raises(InputError, match="different measurements"):
        compare_studies([studies / "simple", tmp_path / "other"])


@pytest.mark.rendered("sbc")
def test_a_study_is_checked_by_simulation(tmp_path, monkeypatch, capsys):
    (tmp_path / "study.toml").write_text(plain("study"))
    arguments = ["structid", "sbc", str(tmp_path / "study.toml"), "--replicas", "20", "--out", str(tmp_path / "sbc")]
    monkeypatch.setattr("sys.argv", arguments)
    with pytest.raises(SystemExit) as ended:
        cli()
    said = capsys.readouterr().out
    assert ended.value.code in (0, 3) and "90 % holds" in said and (tmp_path / "sbc" / "sbc.png").is_file()


@pytest.mark.rendered("sbc")
def test_whole_calibrations_of_a_study_are_checked_by_simulation(tmp_path, monkeypatch, capsys):
    """Draws of the prior stand for each calibration: their ranks are uniform, and none is certified."""

    def outcome(task):
        return {
            "error": np.array(""),
            "draws": task.space.sample(100, seed=task.seed % 2**32).values,
            "certified": np.array(False),
            "error model": np.array("iid" if task.discrepancy == "auto" else task.discrepancy.describe()["kind"]),
            "true runs": np.array(float(task.plan.true_runs)),
            "seconds": np.array(1.0),
        }

    monkeypatch.setattr(simulated_calibrations, "available_cores", lambda: 1)
    monkeypatch.setattr(simulated_calibrations, "outcome_of", outcome)
    (tmp_path / "study.toml").write_text(plain("study"))
    out = tmp_path / "sbc"
    options = ["--whole", "--replicas", "40", "--noise", "0.1", "--out", str(out)]
    monkeypatch.setattr("sys.argv", ["structid", "sbc", str(tmp_path / "study.toml"), *options])
    with pytest.raises(SystemExit) as ended:
        cli()
    said = capsys.readouterr().out
    assert ended.value.code == 0 and "Certified: 0 of 40" in said and "Error models: iid 40." in said
    assert (out / "sbc.png").is_file() and (out / "simulated.journal").is_file()


def test_a_study_with_a_surrogate_is_checked_with_it_if_it_may_stand_in(tmp_path):
    """Twenty runs are too few for the gate; who trusts the surrogate all the same is heard, as in a run."""
    study = tmp_path / "study.toml"
    text = plain("study").replace('kind = "none"', 'kind = "pod_kriging"\nlimit = 1e-9') + "\n[campaign]\nruns = 20\n"
    study.write_text(text)
    with pytest.raises(InputError, match=r"1e-09 or less.*trust\(\)"):
        check_by_simulation(study, 20)
    study.write_text(text.replace("limit = 1e-9", "limit = 1e-9\ntrust = true"))
    found, figure = check_by_simulation(study, 20)
    assert figure is None and "stiffness" in str(found)


def test_the_packaged_study_is_certified_and_offers_every_sampler():
    assert "[calibration]" in PACKAGED and all(k in PACKAGED for k in ("aies", "nuts", "delayed_acceptance"))
