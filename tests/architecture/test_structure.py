"""The public names of the contract, a quick command line, and a lock that holds what the project names."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import structid

pytestmark = pytest.mark.quick

REPOSITORY = Path(__file__).parents[2]


def test_every_public_name_resolves_and_is_listed():
    for name in dir(structid):
        assert getattr(structid, name) is not None
    with pytest.raises(AttributeError, match="bananas"):
        _ = structid.bananas


CONTRACT = [
    *(
        "GroundMotion",
        "ForceHistory",
        "DisplacementHistory",
        "ParameterSpace",
        "Uniform",
        "Normal",
        "LogNormal",
        "Gamma",
    ),
    *(
        "Beta",
        "Weibull",
        "Gumbel",
        "Frozen",
        "BoucWen",
        "ShearFrame",
        "Observation",
        "Posterior",
        "IID",
        "AIES",
        "sample",
    ),
    *("Histories", "Status", "LogDensity", "InputError", "optimize"),
]


def test_the_contract_stands():
    assert set(CONTRACT) <= set(dir(structid))


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("structid.cli.main", ("jax", "numpyro", "arviz", "matplotlib", "scipy")),
        # Every child process of a guarded solver imports it.
        (
            "structid.models.external.external",
            ("jax", "numpyro", "arviz", "matplotlib", "scipy.stats", "scipy.signal", "scipy.special"),
        ),
    ],
)
def test_what_should_start_at_once_loads_no_heavy_library(module, heavy):
    code = f"import sys, {module}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_lock_holds_what_the_project_names():
    """What is missing there is missing on every new machine."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    groups = project["dependency-groups"]
    named = [*project["project"]["dependencies"], *groups["test"], *groups["lint"], *groups["build"]]
    locked = set(re.findall(r"^([\w.-]+)==", (REPOSITORY / "requirements.lock").read_text(), flags=re.MULTILINE))
    assert {re.match(r"[\w-]+", name)[0].lower() for name in named} <= locked
