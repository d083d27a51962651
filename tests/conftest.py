"""What tests share: real data beside the checkout, the benchmark study, a small one that is quick."""

from __future__ import annotations

import contextlib
import gc
import os
import warnings
from pathlib import Path

import numpy as np
import pytest

import plain_code
import shape_checks
import structid as si
from memory import Memory
from oscillators import DEGRADING
from pictures import Pictures

shape_checks.watch()
plain_code.of_long_loops()

# A worker comes to hold two million objects, most of them JAX's. To look for garbage among all of them, as often as Python does by
# itself, was an eighth of the time. What the imports leave is never garbage; compiling leaves a quarter of a megabyte a program.
gc.set_threshold(10_000, 10, 1)

if "PYTEST_XDIST_WORKER" not in os.environ:
    # On import ArviZ 0.23 notes that it has given its warning of the day, and two workers at once trip over each other's note.
    with contextlib.suppress(ImportError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz  # noqa: F401


def pytest_collection_finish():
    """Leave what is imported out of the search for garbage."""
    gc.collect()
    gc.freeze()


SHARED = Path(os.environ.get("STRUCTID_SHARED", Path(__file__).parents[2] / "shared"))


@pytest.fixture(scope="session", autouse=True)
def pictures():
    """Figures are composed in every test, and made into pictures only in those marked `rendered`."""
    with pytest.MonkeyPatch.context() as patch:
        yield Pictures(patch)


@pytest.fixture(scope="session", autouse=True)
def memory():
    """A worker that has compiled hundreds of programs would hold gigabytes."""
    return Memory()


@pytest.fixture(autouse=True)
def _gives_memory_back(memory: Memory):
    yield
    memory.give_back()


@pytest.fixture(autouse=True)
def _rendered(request: pytest.FixtureRequest, pictures: Pictures):
    marker = request.node.get_closest_marker("rendered")
    with pictures.rendering(marker.args if marker else None):
        yield


@pytest.fixture(scope="session")
def strong_motion() -> Path:
    folder = SHARED / "data" / "strong_motion"
    if not folder.is_dir():
        pytest.skip(f"no records at {folder}")
    return folder


@pytest.fixture(scope="session")
def shared_data() -> Path:
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(f"no data at {folder}")
    return folder


@pytest.fixture(scope="session")
def record() -> si.GroundMotion:
    return si.GroundMotion.synthetic(seed=8).lowpass(20.0).scale_to_pga(1.8)


@pytest.fixture(scope="session")
def short_record() -> si.GroundMotion:
    return si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(3.0, 9.0).scale_to_pga(1.8)


@pytest.fixture(scope="session")
def study_space() -> si.ParameterSpace:
    return si.ParameterSpace(
        stiffness=si.Normal(7.42, 0.742, low=4.27, high=11.85, unit="kN/mm"),
        beta=si.Uniform(55.0, 65.0, unit="1/m"),
        gamma_ratio=si.Uniform(-1.0, 1.0),
        alpha=si.LogNormal(mean=0.063, sd=0.01, high=1.0),
    )


@pytest.fixture(scope="session")
def short_posterior(study_space: si.ParameterSpace, short_record: si.GroundMotion) -> si.Posterior:
    """A posterior that takes a millisecond: six seconds of record, one substep."""
    truth = si.BoucWen(**DEGRADING, substeps=1)
    velocity = truth.simulate(np.zeros((1, 0)), short_record).channel("velocity")[0]
    noise = np.random.default_rng(0).standard_normal(velocity.size) * 0.02 * velocity.std()
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=study_space.names, substeps=1)
    return si.Posterior(study_space, model, si.Observation(short_record, velocity + noise))
