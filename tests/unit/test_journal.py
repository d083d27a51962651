import numpy as np
import pytest

from structid.errors import InputError, StoreMismatchError
from structid.journal import Journal


def entries(journal):
    return [int(e["x"][0]) for e in journal]


def test_entries_come_back(tmp_path):
    journal = Journal(tmp_path / "j", {"seed": 1})
    for i in range(5):
        journal.append({"x": np.array([i])})
    assert entries(Journal(tmp_path / "j", {"seed": 1})) == [0, 1, 2, 3, 4]


def test_torn_at_every_byte_keeps_what_was_finished(tmp_path):
    path = tmp_path / "j"
    journal = Journal(path, {"seed": 1})
    sizes = []
    for i in range(3):
        journal.append({"x": np.array([i])})
        sizes.append(path.stat().st_size)
    whole = path.read_bytes()
    header = 2 * sizes[0] - sizes[1]  # the entries are alike
    for length in range(header, len(whole), 7):
        path.write_bytes(whole[:length])
        again = Journal(path, {"seed": 1})
        finished = sum(size <= length for size in sizes)
        assert entries(again) == list(range(finished))
        again.append({"x": np.array([99])})
        assert entries(Journal(path, {"seed": 1})) == [*range(finished), 99]


def test_a_flipped_bit_is_found(tmp_path):
    path = tmp_path / "j"
    journal = Journal(path, {"seed": 1})
    journal.append({"x": np.array([1])})
    content = bytearray(path.read_bytes())
    content[-5] ^= 1
    path.write_bytes(content)
    assert entries(Journal(path, {"seed": 1})) == []


def test_another_identity_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "j"
    Journal(path, {"seed": 1}).append({"x": np.array([1])})
    before = path.read_bytes()
    with pytest.raises(StoreMismatchError, match="seed is 1 there and 2 here"):
        Journal(path, {"seed": 2})
    assert path.read_bytes() == before


def test_a_foreign_file_is_refused(tmp_path):
    (tmp_path / "j").write_text("my thesis")
    with pytest.raises(InputError, match="not a structid journal"):
        Journal(tmp_path / "j", {})
    assert (tmp_path / "j").read_text() == "my thesis"
