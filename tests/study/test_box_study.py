"""Studies of a box of parameters: runs over the priors, by themselves, again, and every mistake in a paragraph."""

import re

import numpy as np
import pytest

import structid as si
from commands import structid
from structid.campaign.runs import Runs
from structid.reliability.parameter_study import ParameterStudy
from structid.study.run import load, report_again, run_study
from studies import SMALL

STUDY = (
    SMALL[: SMALL.index("[observation]")]
    + """
[parameter_study]
runs = 60
channel = "displacement"
limits = ["20 mm", 0.04]
above = { stiffness = "7.5 kN/mm" }
peaks = ["displacement", "restoring_force"]
"""
)


@pytest.fixture
def study(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path / "study.toml"


def test_runs_over_the_priors_and_the_page_again(study):
    folder = study.parent / "out"
    outcome = run_study(study, folder)
    found = outcome.results[ParameterStudy]
    assert (
        Runs not in outcome.results
        and found.runs.channels == ("displacement", "restoring_force")
        and len(found.runs) == 60
    )
    assert [p.limit for p in found.passages] == [0.02, 0.04]
    largest = np.abs(found.runs.channel("displacement")).max(axis=1)
    for passages in found.passages:
        np.testing.assert_array_equal(passages.passed, largest > passages.limit)
    assert found.inside.sum() == (found.runs.design.values[:, 0] > 7.5e6).sum()
    page = outcome.report.read_text()
    assert "Parameters and first passages" in page and "stiffness above 7.5 kN/mm" in page
    again = report_again(folder)
    assert again.report.read_text().count("<figure>") == page.count("<figure>")
    np.testing.assert_array_equal(again.results[ParameterStudy].runs.values, found.runs.values)


def test_a_box_of_one_parameter(study):
    """All of the variance is its own; there are no pairs to draw."""
    text = study.read_text()
    tables = [name for name in ("beta", "gamma_ratio", "alpha") if f"[parameters.{name}]" in text]
    for name in tables:
        begin = text.index(f"[parameters.{name}]")
        text = text[:begin] + text[text.index("\n[", begin) + 1 :]
    text = re.sub(r"^(\[model\].*\n)", "\\1alpha = 0.06\nbeta = 60.0\ngamma_ratio = 0.5\n", text, flags=re.M)
    study.write_text(text)
    outcome = run_study(study, study.parent / "out")
    assert [found.first.tolist() for found in outcome.results[ParameterStudy].sensitivities.values()] == [[1.0], [1.0]]
    assert "Parameters and first passages" in outcome.report.read_text()


@pytest.mark.slow
def test_beside_a_calibration(study):
    text = SMALL + STUDY[STUDY.index("[parameter_study]") :]
    study.write_text(text)
    outcome = run_study(study, study.parent / "out")
    assert outcome.result is not None and ParameterStudy in outcome.results
    page = outcome.report.read_text()
    assert page.index(">Other records<") < page.index(">Parameters and first passages<")


def test_on_the_command_line(study):
    done = structid("run", "study.toml", "--out", "out", cwd=study.parent)
    assert done.returncode == 0, done.stderr
    assert "Passages of displacement over 0.02" in done.stdout and "Sobol' indices" in done.stdout
    told = structid("check", "study.toml", cwd=study.parent)
    assert told.returncode == 0 and "Runs over the priors: 60 model runs" in told.stdout


@pytest.mark.parametrize(
    ("said", "instead", "told"),
    [
        ('"20 mm"', '"20 kN"', "parameter_study.limits"),
        ("above = { stiffness", "above = { stifness", "stiffness"),
        ('channel = "displacement"', 'channel = "displacment"', "displacement"),
        ("runs = 60", "runs = 6", "20"),
        ("runs = 60", "runs = 202499170860", "parameter_study.runs.*at most 1000000"),
        ('limits = ["20 mm", 0.04]', "limits = []", "limits"),
        ('"7.5 kN/mm"', '"7.5 kg"', "parameter_study.above.stiffness"),
    ],
)
def test_a_mistake_is_one_paragraph(study, said, instead, told):
    study.write_text(STUDY.replace(said, instead))
    with pytest.raises(si.InputError, match=told):
        load(study)
