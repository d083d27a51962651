"""What surrogates are held to on the benchmark study and on the Bouc-Wen benchmark; minutes long."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import structid as si

EXAMPLE = Path(__file__).parents[2] / "examples" / "narx_benchmark.py"
LIMITS = {"PODKriging": (5e-5, 1e-2), "PODPCE": (5e-4, 1e-1), "PCNARX": (5e-4, 1e-2), "KrigingNARX": (5e-4, 1e-2)}
"""Largest mean and worst error."""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def runs(shared_data, study_space):
    values = np.load(shared_data.parent / "peers" / "record.npy")
    record = si.GroundMotion(values, 0.01, "peers").lowpass(20.0).trim(0.0, 40.0).scale_to_pga(3.59)
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=study_space.names)
    design, unseen = study_space.sample(500, 1, "sobol", 2.0), study_space.sample(1000, 2, "random")
    return [si.Campaign(model, record, d).run() for d in (design, unseen)]


@pytest.mark.parametrize("kind", LIMITS)
def test_validation_errors_on_the_hard_record(kind, runs, capsys):
    validation = getattr(si, kind)().fit(runs[0]).validate(runs[1])
    with capsys.disabled():
        print(f"\n{kind}: {validation}")
    mean, worst = LIMITS[kind]
    assert validation.diverged == 0 and validation.mean <= mean and validation.worst <= worst
    assert validation.coverage > 0.9


def test_narx_of_the_bouc_wen_benchmark(shared_data, capsys):
    """Free-run error on the official test at most 5e-5 m."""
    specification = importlib.util.spec_from_file_location("narx_benchmark", EXAMPLE)
    example = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(example)
    folder = shared_data / "bouc_wen_benchmark"
    error = example.test_error(folder, example.identify(folder, example.KINDS["hysteretic memory"]))
    with capsys.disabled():
        print(f"\nNARX with hysteretic memory: {error:.2e} m on the multisine test")
    assert error <= 5e-5
