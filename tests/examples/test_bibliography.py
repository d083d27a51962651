"""The bibliography is complete: what code and documents cite is in it, and bare equation numbers say whose they are."""

import io
import re
import tokenize
import tomllib
from pathlib import Path

import pytest

import structid

SOURCE = Path(structid.__file__).parent
DOCS = Path(__file__).parents[2] / "docs"
BIBLIOGRAPHY = DOCS / "bibliography.md"
LISTED = BIBLIOGRAPHY.read_text()
DOI = re.compile(r"\b10\.\d{4,9}/[^\s\"`\],;]+")
ARXIV = re.compile(r"\b\d{4}\.\d{4,5}(?:v\d+)?\b")
EQUATION = re.compile(r"\[[2-5]\.[1-9]\d?[a-z]?(?:, [2-5]\.[1-9]\d?[a-z]?)*\]")
FILES = sorted([*SOURCE.rglob("*.py"), *DOCS.rglob("*.md"), *SOURCE.rglob("*.html")])
MODULES = sorted(SOURCE.rglob("*.py"))


def dois(text: str) -> set[str]:
    """Dois of a text, without the full stop or the brackets of the sentence around them."""
    found = {match.rstrip(".:") for match in DOI.findall(text)}
    return {doi[:-1] if doi.endswith(")") and doi.count(")") > doi.count("(") else doi for doi in found}


def arxiv_numbers(text: str) -> set[str]:
    """Numbers after the word arXiv, however a line is broken between them."""
    return {number for group in re.findall(r"arXiv[:\s]+(\S+)", text) for number in ARXIV.findall(group)}


def prose(path: Path) -> str:
    """Comments and strings of a file: an equation number there is a citation, an index in the code is not."""
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text()).readline)
    return "\n".join(t.string for t in tokens if t.type in (tokenize.COMMENT, tokenize.STRING))


def opening(path: Path) -> str:
    """The module docstring."""
    return re.match(r'\s*"""(.*?)"""', path.read_text(), re.S).group(1)


def test_the_reader_of_citations_reads_them():
    assert dois("(A. Body 1983, doi 10.1007/BF01033232).") == {"10.1007/BF01033232"}
    assert dois("doi 10.1061/(ASCE)0733-9399(2007)133:7(816). Next") == {"10.1061/(ASCE)0733-9399(2007)133:7(816)"}
    assert dois("2018,\narXiv 1804.06788), half") == set()
    assert arxiv_numbers("2018,\narXiv 1804.06788), and arXiv\n2402.10797.") == {"1804.06788", "2402.10797"}
    assert EQUATION.search("J(θ) [3.22]") and not EQUATION.search("in [0.5, 2.0]")


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_every_doi_and_arxiv_number_is_listed(path):
    text = path.read_text()
    assert dois(text) <= dois(LISTED)
    assert arxiv_numbers(text) <= arxiv_numbers(LISTED)


def test_no_source_is_listed_twice():
    entries = re.findall(r"doi (10\.\S+?)[.,]?(?:\s|$)", LISTED)
    assert len(entries) > 30
    assert len(set(entries)) == len(entries)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: p.name)
def test_a_file_with_equation_numbers_says_whose_they_are(path):
    text = prose(path)
    if EQUATION.search(text) or re.search(r"\bthesis eqs?\. \d", text):
        assert "thesis" in opening(path) and "docs/bibliography.md" in opening(path)
    assert not re.search(r"\b[Tt]he source('s (figure|table)| prints| calls)", text), "say whose: the thesis's"


def test_the_bibliography_says_how_the_numbers_are_read():
    assert "equation 3.12 of the thesis" in LISTED and "### Corrections" in LISTED
    used = {n for path in MODULES for group in EQUATION.findall(prose(path)) for n in re.findall(r"\d\.\d+", group)}
    assert {"2.31", "3.9", "3.12", "3.22"} <= used


def test_the_citation_names_the_version_of_the_package():
    root = DOCS.parent
    version = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (root / "CITATION.cff").read_text()
