"""The benchmark of nonlinear system identification: truth recovered, sds at the Cramér-Rao bound, test predicted."""

import importlib.util
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "bouc_wen_benchmark.py"
DATA = EXAMPLE.parents[2] / "shared" / "data" / "bouc_wen_benchmark"


@pytest.fixture(scope="module")
def figures():
    """Run the example once, with its own settings and without its figure."""
    if not DATA.is_dir():
        pytest.skip(f"no data at {DATA}")
    specification = importlib.util.spec_from_file_location("bouc_wen_benchmark", EXAMPLE)
    example = importlib.util.module_from_spec(specification)
    # A dataclass looks its own module up by name.
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, specification.name, example)
        specification.loader.exec_module(example)
        yield example.main(DATA, figure=None)


@pytest.mark.slow
def test_every_parameter_is_within_three_sds_of_the_truth(figures):
    assert figures["converged"]
    assert len(figures["parameters"]) == 7
    for name, row in figures["parameters"].items():
        assert row["error_in_sds"] <= 3.0, name


@pytest.mark.slow
def test_posterior_sds_are_the_cramer_rao_bound(figures):
    for name, row in figures["parameters"].items():
        assert row["sd_over_bound"] == pytest.approx(1.0, abs=0.2), name


@pytest.mark.slow
def test_official_test_is_predicted(figures):
    assert figures["test_rms"] <= 6e-7
