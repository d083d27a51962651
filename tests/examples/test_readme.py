"""What the README shows is run: its Python, its study file, and its links."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import structid as si
from structid.study.run import load

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(language):
    [found] = re.findall(rf"```{language}\n(.*?)```", README, re.S)
    return found


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """A folder with the two files that the README's examples read."""
    monkeypatch.chdir(tmp_path)
    record = si.GroundMotion.synthetic(seed=8, duration=12.0).scale_to_pga(1.8)
    rows = "\n".join(
        " ".join(f"{v: .7E}" for v in record.values[i : i + 5] / 9.80665) for i in range(0, len(record), 5)
    )
    head = (
        f"PEER NGA\nSYNTHETIC\nACCELERATION TIME SERIES IN UNITS OF G\nNPTS= {len(record)}, DT= {record.dt:.4f} SEC\n"
    )
    Path("record.AT2").write_text(head + rows + "\n")
    truth = si.BoucWen(mass=12e3, damping_ratio=0.03, alpha=0.06, stiffness=7.6e6, beta=61.0, gamma_ratio=0.8)
    velocity = 1e3 * truth.simulate([[]], record.lowpass(20.0)).channel("velocity")[0]
    velocity += np.random.default_rng(1).normal(0.0, 0.02 * velocity.std(), velocity.shape)
    np.savetxt("velocity.csv", np.c_[record.time, velocity], delimiter=", ", fmt="%.5f")


def test_the_python_runs_and_is_certified(measured, capsys):
    found = {}
    exec(compile(block("python"), "README.md", "exec"), found)
    result = found["result"]
    assert result.certificate.certified and "CERTIFIED" in capsys.readouterr().out
    truth = np.array([7.6e6, 61.0, 0.8])
    assert (np.abs(result.mean[:3] - truth) < 4.0 * result.sd[:3]).all()


def test_the_study_file_is_in_order(measured):
    Path("my_structure.toml").write_text(block("toml"))
    study = load("my_structure.toml")
    assert study.posterior.names[:3] == ("stiffness", "beta", "gamma_ratio")
    assert tomllib.loads(block("toml"))["calibration"]["true_runs"] == 500


def test_every_link_leads_somewhere():
    links = re.findall(r"\]\(([^)]+)\)", README)
    assert len(links) > 20
    missing = [link for link in links if not link.startswith("http") and not (ROOT / link.split("#")[0]).exists()]
    assert not missing


def test_it_is_a_screen_and_a_half():
    assert len(README.splitlines()) < 120
