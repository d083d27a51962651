"""Every example runs."""

import importlib.util
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import structid as si
from structid.calibration.calibration_result import CalibrationResult
from structid.campaign.runs import Runs
from structid.study.run import load, run_study

EXAMPLES = Path(__file__).parents[2] / "examples"
TESTED = {
    "narx_benchmark.py",  # in tests/statistical
    "bouc_wen_benchmark.py",  # in tests/statistical
    "calibrate_in_python.py",
    "cyclic_test.py",
    "el_centro.toml",
    "facade.toml",
    "linear_limit.py",
}


def imported(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


FOLDERS = {"c_solver", "opensees_oscillator"}


def test_no_example_is_forgotten():
    assert {p.name for p in EXAMPLES.iterdir() if p.is_file()} == TESTED
    assert {p.name for p in EXAMPLES.iterdir() if p.is_dir() and p.name != "__pycache__"} == FOLDERS


@pytest.mark.slow
@pytest.mark.rendered
def test_the_facade_is_certified_and_drawn(tmp_path):
    """Box, certificate, pictures, film and fragility of the packaged facade, with fewer runs."""
    outcome = run_study(EXAMPLES / "facade.toml", tmp_path / "out")
    assert outcome.trusted and outcome.results[CalibrationResult].certificate.true_runs <= 400
    truth = np.array([3.5e3, 1.1e6, 2.5e5, 1.6e6])
    assert (np.abs(outcome.result.mean[:4] - truth) < 4.0 * outcome.result.sd[:4]).all()
    page = outcome.report.read_text()
    for title in ("The structure in motion", "Parameters and first passages", "Probability of failure"):
        assert f">{title}</h2>" in page
    assert "data:image/gif;base64," in page and "Posterior in the coordinates" in page
    assert (tmp_path / "out" / "figures" / "wall_deformed.svg").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.rendered
def test_a_cyclic_test_chooses_its_law(shared_data, tmp_path):
    path = shared_data / "hysteresis" / "FD_PG1_Almeida2012.csv"
    assert imported("cyclic_test").main(path, tmp_path / "loops", ("bilinear", "masing")) < 0.040
    assert (tmp_path / "loops.png").stat().st_size > 10_000


def test_the_real_record_study_builds(strong_motion):
    built = load(EXAMPLES / "el_centro.toml")
    assert built.record.pga == pytest.approx(1.8)
    assert len(built.record) == 4001


@pytest.mark.slow
def test_the_readme_script_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = imported("calibrate_in_python").main(steps=60)
    assert not result.verdict().converged  # sixty steps: it says so


@pytest.mark.rendered
def test_the_linear_limit_matches_duhamel(tmp_path):
    assert imported("linear_limit").main(tmp_path / "linear") < 2e-4
    assert (tmp_path / "linear.png").stat().st_size > 10_000


def copied(name, tmp_path, runs=16):
    """A folder of an example, its campaign made small."""
    folder = tmp_path / name
    shutil.copytree(EXAMPLES / name, folder, ignore=shutil.ignore_patterns("out", "__pycache__"))
    study = folder / "study.toml"
    study.write_text(study.read_text().replace("runs = 200", f"runs = {runs}"))
    return folder


def built_in(runs):
    """What our own oscillator responds at the same points."""
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=runs.design.names, substeps=3)
    return model.simulate(runs.design.values, runs.records[0])


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_the_solver_in_c_is_compiled_and_agrees_with_ours(tmp_path):
    folder = copied("c_solver", tmp_path)
    subprocess.run(["make", "oscillator"], cwd=folder, check=True, capture_output=True)
    runs = run_study(folder / "study.toml", tmp_path / "out", executor="processes").results[Runs]
    assert runs.done.all(), runs.reasons
    space = si.ParameterSpace(**runs.design.space.marginals)
    ours = built_in(replace(runs, design=si.Design(runs.design.values, space)))
    np.testing.assert_allclose(runs.values, ours.values, rtol=0, atol=1e-9 * np.abs(ours.values).max())


def test_the_opensees_model_runs_and_is_near_ours(tmp_path):
    pytest.importorskip("openseespy.opensees", reason="OpenSeesPy is not here, or cannot be loaded")
    study = copied("opensees_oscillator", tmp_path, 6) / "study.toml"
    runs = run_study(study, tmp_path / "out", executor="processes").results[Runs]
    assert runs.done.all(), runs.reasons
    # Its material integrates z by backward Euler: of first order in the step, so near and not equal.
    difference = runs.values - built_in(runs).values
    assert np.sqrt((difference**2).mean() / (runs.values**2).mean()) < 0.15
