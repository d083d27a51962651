"""The benchmark of nonlinear system identification: truth recovered, sds at the Cramér-Rao bound, test predicted."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "bouc_wen_benchmark.py"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings(
        "ignore:In .* of the prior .gamma. exceeds beta"
    ),  # as those who made the benchmark mean it
]


@pytest.fixture(scope="module")
def figures(shared_data):
    """What the example reports, run once with half of its steps and without its figure."""
    data = shared_data / "bouc_wen_benchmark"
    if not data.is_dir():
        pytest.skip(f"no data at {data}")
    specification = importlib.util.spec_from_file_location("bouc_wen_benchmark", EXAMPLE)
    example = importlib.util.module_from_spec(specification)
    with pytest.MonkeyPatch.context() as patch:
        # A dataclass looks its own module up by name.
        patch.setitem(sys.modules, specification.name, example)
        specification.loader.exec_module(example)
        return example.main(data, figure=None, sampler=replace(example.SAMPLER, steps=30))


def test_every_parameter_is_within_three_sds_of_the_truth(figures):
    assert figures["converged"]
    assert len(figures["parameters"]) == 7
    for name, row in figures["parameters"].items():
        assert row["error_in_sds"] <= 3.0, name


def test_posterior_sds_are_the_cramer_rao_bound(figures):
    for name, row in figures["parameters"].items():
        assert row["sd_over_bound"] == pytest.approx(1.0, abs=0.2), name


def test_official_test_is_predicted(figures):
    assert figures["test_rms"] <= 6e-7
