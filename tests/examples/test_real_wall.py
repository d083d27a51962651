"""The tutorial on a real wall shows what the commands print."""

import re
import shutil
from pathlib import Path

import pytest

from commands import structid

PAGE = Path(__file__).parents[2] / "docs" / "tutorial" / "real_wall.md"
WALL = "FD_PG1_Almeida2012.csv"


def blocks(language: str) -> list[str]:
    """The blocks of the page in one language."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), flags=re.S)


NUMBER = r"\d+(?:\.\d+)?"


def contains(sentence: str, text: str) -> bool:
    """Return whether a text has a sentence, with numbers that differ by less than a tenth: machines round differently."""
    parts = re.split(f"({NUMBER})", " ".join(sentence.split()))
    pattern = "".join(f"({NUMBER})" if k % 2 else re.escape(part) for k, part in enumerate(parts))
    found = re.search(pattern, " ".join(text.split()))
    expected = [float(number) for number in re.findall(NUMBER, sentence)]
    return found is not None and [float(n) for n in found.groups()] == pytest.approx(expected, rel=0.1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, shared_data):
    """A folder with the file of the wall, and a new study of it."""
    folder = tmp_path_factory.mktemp("wall")
    shutil.copy(shared_data / "hysteresis" / WALL, folder)
    made = structid("new", "wall", "--like", "cyclic", "--from", WALL, cwd=folder)
    assert made.returncode == 0, made.stderr
    return folder


def test_the_new_study_and_its_check_are_those_of_the_page(folder):
    study, *_ = blocks("toml")
    table, model = study.split("\n\n")
    text = (folder / "wall.toml").read_text()
    assert table in text
    assert all(line in text for line in model.split("\n"))
    checked = structid("check", "wall.toml", cwd=folder)
    assert blocks("text")[1] in re.sub(r"Laws to choose among.*\n", "", checked.stdout)


@pytest.mark.slow
def test_the_choice_is_that_of_the_page(folder):
    run = structid("run", "wall.toml", cwd=folder)
    assert run.returncode == 0, run.stderr
    first, choice, lacking = blocks("text")[2:5]
    assert all(contains(line, run.stdout) for line in first.strip().split("\n"))
    assert contains(choice, run.stdout)
    assert contains(lacking, run.stdout)
