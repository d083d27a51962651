"""structid certify: draws of another program against a study's model."""

import json
from dataclasses import replace

import numpy as np
import pytest

import structid as si
from commands import structid
from structid.certification.correction import Correction
from structid.report.material.certificate_material import CertificateMaterial
from structid.report.page import write_certificate_report
from structid.study.run import load
from studies import PLAIN, shortened

STUDY = shortened(PLAIN).replace('kind = "auto"', 'kind = "iid"')


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A study, and draws of its posterior."""
    folder = tmp_path_factory.mktemp("draws")
    (folder / "study.toml").write_text(STUDY)
    posterior = load(folder / "study.toml").posterior
    result = si.sample(posterior, si.SMC(particles=200, steps=25, effective_share=0.5, correlation=0.3), seed=1)
    result.to_netcdf(folder / "draws.nc", predictions=False)
    return folder, result


def csv(path, result, shift=0.0):
    rows = result.flat + shift * result.sd * (np.arange(len(result.names)) == 0)
    np.savetxt(path, rows, delimiter=",", header=",".join(result.names), comments="")


def test_good_draws_with_their_density(drawn):
    folder, result = drawn
    called = structid("certify", "study.toml", "draws.nc", "--out", "good", cwd=folder)
    head = (
        "CERTIFIED for a density that is known only at the draws, if it has no mode far from them (36 model runs, "
        "30 of them at fresh draws, 5 in search"
    )
    assert called.returncode == 0 and head in called.stdout, called.stdout + called.stderr
    page = (folder / "good" / "report.html").read_text()
    assert "Certified." in page and "Draws from draws.nc" in page and "Difference between model and draws" in page
    figures = json.loads((folder / "good" / "certificate.json").read_text())
    assert figures["verdict"] == "certified" and figures["names"] == list(result.target.compared_names)
    again = structid("certify", "study.toml", "draws.nc", "--out", "good", cwd=folder)
    assert again.returncode == 0


def test_wrong_draws_in_a_table(drawn):
    folder, result = drawn
    csv(folder / "wrong.csv", result, shift=0.3)
    called = structid("certify", "study.toml", "wrong.csv", "--out", "wrong", cwd=folder)
    assert called.returncode == 3 and "for a density that was fitted to the draws" in called.stdout, called.stderr
    page = (folder / "wrong" / "report.html").read_text()
    assert "do not use these draws" in page and "posterior do not agree" in page and "error of every mean" not in page


def test_draws_of_another_study(drawn):
    folder, result = drawn
    csv(folder / "other.csv", result)
    text = (folder / "other.csv").read_text().replace(result.names[0], "mass", 1)
    (folder / "other.csv").write_text(text)
    called = structid("certify", "study.toml", "other.csv", "--out", "other", cwd=folder)
    assert called.returncode == 2 and f"Add draws of {result.names[0]}" in called.stderr


def test_what_the_runs_have_taught_is_on_the_page(tmp_path):
    space = si.ParameterSpace(a=si.Normal(0.0, 1.0), b=si.Normal(0.0, 1.0))
    target = si.LogDensity(space.log_density, ("a", "b"), space)
    found = si.certify(target, np.random.default_rng(1).standard_normal((2000, 2)), space.log_density)
    moved, correlation = np.array([0.05, -0.02]), np.array([[0.0, -0.16], [-0.16, 0.0]])
    correction = Correction(0.034, moved, np.array([0.004, 0.001]), np.array([1.03, 0.99]), correlation)
    pages = []
    for place, one in enumerate((found, replace(found, correction=correction, missing=0.0071))):
        material = CertificateMaterial("Draws", "", "draws.nc", one, ("a", "b"), ("m", ""), np.array([1.0, 1.0]))
        pages.append(write_certificate_report(material, tmp_path / str(place), {}).read_text())
    told = ("Their total variation distance is 3.4 %", "+0.050 ± 0.004", "+3.0 %", "0.71%", "-0.16 with b")
    assert all(said in pages[1] and said not in pages[0] for said in told)
