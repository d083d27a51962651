"""The pages of the site: every kind is there, and every key of a study file has a sentence and an example.

`make lint` checks their code and their links (`tools/check_style.py`); `make docs` executes the examples.
"""

import importlib
import re
import shutil
from pathlib import Path

import check_style

DOCS = Path(__file__).parents[2] / "docs"


def test_there_are_pages_of_every_kind():
    rooms = {page.parent.name for page in check_style.pages()}
    assert {"tutorial", "how_to", "theory", "reference", "developers"} <= rooms and len(check_style.pages()) > 20


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
        "RecordTable: scale has no example",
        "lowpass = '20 m' is refused",
        "does not know resampled",
        "gap has no sentence",
    ):
        assert said in found
