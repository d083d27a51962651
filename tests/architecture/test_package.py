"""What is packaged says the same everywhere: versions, dependencies, extras."""

import re
import tomllib
from pathlib import Path

import structid

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
RECIPE = (ROOT / "packaging" / "conda" / "meta.yaml").read_text()
DOCKERFILE = (ROOT / "packaging" / "Dockerfile").read_text()
ON_CONDA = {"matplotlib": "matplotlib-base"}
"""Names that conda-forge gives to a package."""


def test_the_version_is_the_same_everywhere():
    version = PROJECT["version"]
    assert structid.__version__ == version
    assert f"version: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f'version = "{version}"' in RECIPE
    assert re.search(rf"^## {re.escape(version)} ", (ROOT / "CHANGELOG.md").read_text(), re.M)


def test_the_conda_recipe_has_the_dependencies_of_the_package():
    run = RECIPE[RECIPE.index("  run:") : RECIPE.index("test:")]
    found = dict(re.findall(r"- (\S+) (>=\S+)", run))
    wanted = dict(re.match(r"([A-Za-z0-9_-]+)(.*)", each).groups() for each in PROJECT["dependencies"])
    assert found.pop("python") == PROJECT["requires-python"]
    assert found == {ON_CONDA.get(name, name): bound for name, bound in wanted.items()}


def test_the_image_names_extras_and_files_that_exist():
    [extras] = re.findall(r"\[([a-z,]+)\]\"", DOCKERFILE)
    assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"])
    for line in re.findall(r"^COPY (?!--from)(.*) \S+$", DOCKERFILE, re.M):
        assert all((ROOT / name).exists() for name in line.split())
