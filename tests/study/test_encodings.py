"""A study file as editors save it: with a byte-order mark, in UTF-16; in Latin-1 it is asked for in UTF-8."""

import pytest

from commands import structid
from structid.core.errors import InputError
from structid.study.run import load
from studies import SMALL, without_pages


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-8"])
def test_what_editors_save(tmp_path, encoding):
    (tmp_path / "study.toml").write_text(SMALL.replace("oscillator", "Öszillator"), encoding=encoding)
    assert "Öszillator" in load(tmp_path / "study.toml").file.title


def test_latin_1(tmp_path):
    text = SMALL.replace("–", "-").replace("oscillator", "Öszillator")
    (tmp_path / "study.toml").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"study.toml, line \d+.*not valid UTF-8.*'Ö'.*Save the file as UTF-8"):
        load(tmp_path / "study.toml")


def test_a_study_in_utf_16_runs_and_is_kept_as_text(tmp_path):
    (tmp_path / "study.toml").write_text(SMALL, encoding="utf-16")
    with without_pages():
        done = structid("run", "study.toml", "--out", "out", cwd=tmp_path)
    assert done.returncode == 3, done.stderr  # eighty steps, which do not converge
    assert (tmp_path / "out" / "study.toml").read_text(encoding="utf-8") == SMALL
    with without_pages():
        assert structid("report", "out", cwd=tmp_path).returncode == 3
