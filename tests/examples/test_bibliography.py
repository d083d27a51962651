"""The bibliography: no source twice, how equation numbers are read, and the version that is cited.

`make lint` checks that everything cited is listed (`tools/check_style.py`).
"""

import re
import tomllib
from pathlib import Path

import check_style

ROOT = Path(__file__).parents[2]
LISTED = (ROOT / "docs" / "bibliography.md").read_text(encoding="utf-8")


def test_no_source_is_listed_twice():
    entries = re.findall(r"doi (10\.\S+?)[.,]?(?:\s|$)", LISTED)
    assert len(entries) > 30
    assert len(set(entries)) == len(entries)


def test_the_bibliography_says_how_the_numbers_are_read():
    assert "equation 3.12 of the thesis" in LISTED and "### Corrections" in LISTED
    texts = [check_style.prose(file) for file in check_style.package_files()]
    used = {n for text in texts for group in check_style.EQUATION.findall(text) for n in re.findall(r"\d\.\d+", group)}
    assert {"2.31", "3.9", "3.12", "3.22"} <= used


def test_the_citation_names_the_version_of_the_package():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
