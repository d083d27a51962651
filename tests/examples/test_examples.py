"""Every example runs."""

import importlib.util
import sys
from pathlib import Path

import pytest

from structid.study.run import load

EXAMPLES = Path(__file__).parents[2] / "examples"
TESTED = {
    "bouc_wen_benchmark.py",  # in tests/statistical
    "calibrate_in_python.py",
    "cyclic_test.py",
    "el_centro.toml",
    "linear_limit.py",
}


def imported(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def test_no_example_is_forgotten():
    assert {p.name for p in EXAMPLES.iterdir() if p.is_file()} == TESTED


@pytest.mark.parametrize(("name", "limit"), [("FD_PG1_Almeida2012.csv", 0.10), ("FD_T11_Faella1992.csv", 0.12)])
def test_a_cyclic_test_is_fitted_in_displacement_driven_mode(shared_data, tmp_path, name, limit, capsys):
    unexplained = imported("cyclic_test").main(shared_data / "hysteresis" / name, tmp_path / "loops")
    with capsys.disabled():
        print(f"\n{name}: {unexplained:.2%} of the force's variance unexplained")
    assert unexplained < limit
    assert (tmp_path / "loops.png").stat().st_size > 10_000


def test_the_real_record_study_builds(strong_motion):
    built = load(EXAMPLES / "el_centro.toml")
    assert built.record.pga == pytest.approx(1.8)
    assert len(built.record) == 4001


def test_the_readme_script_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = imported("calibrate_in_python").main(steps=60)
    assert not result.verdict().converged  # sixty steps: it says so


def test_the_linear_limit_matches_duhamel(tmp_path):
    assert imported("linear_limit").main(tmp_path / "linear") < 2e-4
    assert (tmp_path / "linear.png").stat().st_size > 10_000
