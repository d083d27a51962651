"""The tests are a house too: they lie where what they test lies, and no file of them is too long to read."""

from pathlib import Path

import pytest

import structid

TESTS = Path(__file__).parents[1]
SRC = Path(structid.__file__).parent
FILES = sorted(TESTS.rglob("*.py"))
OF_THEIR_OWN = {"architecture", "examples", "helpers", "resume", "seams", "statistical", "verification"}
"""Folders that are about more than one folder of the package."""


def test_tests_lie_where_the_code_lies():
    folders = {file.parent.relative_to(TESTS) for file in FILES}
    strange = [str(f) for f in folders if f.parts and f.parts[0] not in OF_THEIR_OWN and not (SRC / f).is_dir()]
    assert not strange


def test_two_files_of_tests_never_have_the_same_name():
    names = [file.name for file in FILES if file.name.startswith("test_")]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(TESTS)))
def test_a_file_of_tests_has_at_most_450_lines(file):
    assert len(file.read_text(encoding="utf-8").splitlines()) <= 450
