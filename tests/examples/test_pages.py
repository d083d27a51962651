"""The pages of the site as they lie: Python that compiles, study files that parse, commands that exist, links that lead somewhere.

`make docs` executes the examples and checks every link of what it has built.
"""

import importlib
import re
import shlex
import shutil
import tomllib
from pathlib import Path

import pytest

from structid.commands.command_list import COMMANDS

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(
    page for page in DOCS.rglob("*.md") if not {"_build", "names", "project"} & set(page.relative_to(DOCS).parts)
)
WRITTEN_BY_THE_BUILD = ("names/", "../project/")


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M)


def identity(page):
    return str(page.relative_to(DOCS))


def test_there_are_pages_of_every_kind():
    rooms = {page.parent.name for page in PAGES}
    assert {"tutorial", "how_to", "theory", "reference", "developers"} <= rooms and len(PAGES) > 20


@pytest.mark.parametrize("page", PAGES, ids=identity)
def test_python_compiles(page):
    for block in blocks(page, "python"):
        compile(block, str(page), "exec")


@pytest.mark.parametrize("page", PAGES, ids=identity)
def test_study_files_are_toml(page):
    for block in blocks(page, "toml"):
        tomllib.loads(block.replace("…", ""))


def options(command):
    """Options of a command, from its signature."""
    found = {"--help"}
    for name, parameter in command.__annotations__.items():
        given = re.findall(r"'(--[a-z-]+)'", str(parameter))
        found |= set(given) or {f"--{name.replace('_', '-')}"}
    return found


@pytest.mark.parametrize("page", PAGES, ids=identity)
def test_commands_and_their_options_exist(page):
    known = {command.__name__: command for command in COMMANDS}
    text = page.read_text(encoding="utf-8")
    shell = "\n".join(blocks(page, "sh")) + "\n" + "\n".join(re.findall(r"^%%sh\n(.*?)^```", text, re.S | re.M))
    for line in shell.splitlines():
        found = re.match(r"\s*structid (\w+)(.*)", line.split("  #")[0])
        if not found:
            continue
        assert found[1] in known, line
        words = shlex.split(re.split(r"[|>&]", found[2])[0])
        assert {w for w in words if w.startswith("--")} <= options(known[found[1]]), line


@pytest.mark.parametrize("page", PAGES, ids=identity)
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for link in re.findall(r"(?<!\!)\]\(([^)\s]+)\)", text):
        target = link.split("#")[0]
        if re.match(r"[a-z]+:", link) or not target or target.startswith(WRITTEN_BY_THE_BUILD):
            continue
        assert any((page.parent / f"{target}{ending}").exists() for ending in ("", ".md")), link


def test_every_key_of_a_study_has_a_sentence_and_an_example(monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "_ext")
    study_keys = importlib.import_module("study_keys")
    assert study_keys.problems(DOCS / "reference" / "keys") == []
    schema = study_keys.tables(study_keys.study_file())
    assert len(schema) > 20 and ("record.synthetic", "") in schema and ("model", "bouc_wen") in schema


def test_a_key_without_a_sentence_or_with_a_wrong_value_is_found(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(DOCS / "_ext")
    study_keys = importlib.import_module("study_keys")
    keys = tmp_path / "keys"
    shutil.copytree(DOCS / "reference" / "keys", keys)
    record = keys / "study" / "02_record.toml"
    text = record.read_text()
    text = re.sub(r"^scale = .*\n", "", text, flags=re.M).replace('"20 Hz"', '"20 m"').replace("resample", "resampled")
    record.write_text(text + "gap = 1.0\n")
    found = "\n".join(study_keys.problems(keys))
    for said in (
        "RecordSection: scale has no example",
        "lowpass = '20 m' is refused",
        "does not know resampled",
        "gap has no sentence",
    ):
        assert said in found
