"""Whatever dies, hangs, lies or fills up: the test ends in time, the position is held, and no finished step is lost."""

import os
import signal
import time
from collections.abc import Iterator

import numpy as np
import pytest

import hybrid_tests
from hybrid_tests import PATIENCE, SECRET, Processes, storey
from structid.core.errors import InputError
from structid.core.journal import Journal
from structid.hybrid.laboratory.remote import RemoteSpecimen
from structid.hybrid.laboratory.server import SpecimenServer
from structid.hybrid.laboratory.specimen import SpecimenError
from structid.hybrid.recording import recorder as recorder_module
from structid.hybrid.recording.recorder import Following, Recorder, RecordingError, journal_of, recorded, tails_of
from structid.hybrid.recording.result_file import open_hybrid

MOMENTS = [int(k) for k in np.random.default_rng(11).choice(np.arange(1, 95), 20, replace=False)]
"""Finished steps of a hundred after which something happens."""
FEW = MOMENTS[:2]
OF_A_PROCESS = 4.0
"""Seconds in which a client ends: its patience, and the end of a Python process on a machine that does other work."""


@pytest.fixture(scope="module")
def whole():
    """The test that nothing happens to."""
    return hybrid_tests.test_on(storey()).run()


@pytest.fixture
def processes(tmp_path):
    found = []

    def start(**settings):
        found.append(Processes(tmp_path, **settings))
        return found[-1]

    yield start
    for each in found:
        each.stop()


def the_same(result, whole, rows):
    """Nothing is lost, and what is there is what would have been."""
    assert result.steps + 1 >= rows
    np.testing.assert_array_equal(result.coarse.u, whole.coarse.u[: result.steps + 1])
    count = result.steps * hybrid_tests.SUBSTEPS
    np.testing.assert_array_equal(result.histories.fine.part.imposed, whole.histories.fine.part.imposed[:count])


def holds(both):
    """Whether the server has found out, and moves no more."""
    until = time.monotonic() + 5.0
    while True:
        with pytest.raises(SpecimenError) as refused:
            RemoteSpecimen((both.folder / "port").read_text(), SECRET).move(np.zeros((1, 1)))
        if "Another test" not in str(refused.value) or time.monotonic() > until:
            break
    assert "holds its position" in str(refused.value)


def client_killed(processes, whole, moment):
    both = processes()
    both.wait_for(moment)
    both.client.kill()
    both.client.join()
    rows = both.recorded
    result = open_hybrid(both.store)
    the_same(result, whole, rows)
    assert "was interrupted" in result.events[-1].what
    holds(both)


def specimen_signalled(processes, whole, moment, what):
    both = processes()
    both.wait_for(moment)
    os.kill(both.server.pid, what)
    began = time.monotonic()
    out, err = both.ended()
    assert time.monotonic() - began < OF_A_PROCESS, err
    assert "of 100 steps" in out, err
    result = open_hybrid(both.store)
    the_same(result, whole, moment)
    assert not result.finished
    assert result.events
    if what == signal.SIGSTOP:  # it wakes up, and finds its client gone
        os.kill(both.server.pid, signal.SIGCONT)
        holds(both)
    both.server.kill()


def disk_filled(processes, whole, moment):
    # The journal may not grow from then on; the tails are reserved before.
    both = processes(limit=moment)
    out, err = both.ended(60.0)
    assert "of 100 steps" in out, err
    assert "File too large" in out, err
    result = open_hybrid(both.store)  # no room for a store: from the journal
    the_same(result, whole, both.recorded)
    assert not result.finished and moment <= result.steps + 1 <= moment + 2
    assert "its disk was full" in result.events[-1].what
    holds(both)


FAULTS = {
    "client killed": client_killed,
    "specimen killed": lambda p, w, m: specimen_signalled(p, w, m, signal.SIGKILL),
    "specimen hung": lambda p, w, m: specimen_signalled(p, w, m, signal.SIGSTOP),
    "disk full": disk_filled,
}


@pytest.mark.parametrize(("fault", "moment"), zip(FAULTS, [*FEW, *FEW], strict=True))
def test_a_fault(processes, whole, fault, moment):
    FAULTS[fault](processes, whole, moment)


@pytest.mark.slow
@pytest.mark.parametrize("moment", MOMENTS[2:4])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_at_more_moments(processes, whole, fault, moment):
    FAULTS[fault](processes, whole, moment)


# --- faults inside one process --------------------------------------------------------------------------------------


class Misbehaving:
    """A server whose specimen does something else from some move on."""

    def __init__(self, what, at):
        self.specimen, self.what, self.left = storey(), what, at
        self.move_as_it_should, self.specimen.move, self.accepted = self.specimen.move, self.move, np.zeros(1)
        self.server = SpecimenServer(self.specimen, SECRET)

    def move(self, path, averaged=1):
        self.left -= 1
        if self.left >= 0:
            self.accepted = path[-1]
            return self.move_as_it_should(path, averaged)
        if self.what != "disconnects":
            self.accepted = path[-1]
        if self.what == "nan":
            return self.move_as_it_should(path, averaged)._replace(force=np.array([np.nan]))
        if self.what == "disconnects":
            raise OSError("its cable is out")
        time.sleep(1.5 * PATIENCE)
        return self.move_as_it_should(path, averaged)


def misbehaved(folder, whole, what, moment):
    wrong = Misbehaving(what, moment)
    with wrong.server:
        began = time.monotonic()
        result = hybrid_tests.test_on(RemoteSpecimen(wrong.server.address, SECRET, PATIENCE)).run(folder / "test.h5")
        took = time.monotonic() - began
    assert took < 0.02 * moment + 3.0
    known = max(moment - 1, 0)  # the first move only averages the force at rest
    assert result.steps == max(known - 1, 0) // hybrid_tests.SUBSTEPS
    if known:
        the_same(open_hybrid(folder / "test.h5"), whole, result.steps + 1)
    assert wrong.specimen.held
    np.testing.assert_array_equal(wrong.specimen._command, wrong.accepted)


@pytest.mark.parametrize("moment", [0, 3, *[10 * m for m in FEW]])
@pytest.mark.parametrize("what", ["nan", "disconnects", "late"])
def test_a_specimen_that_misbehaves(tmp_path, whole, what, moment):
    misbehaved(tmp_path, whole, what, moment)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["nan", "disconnects", "late"])
def test_a_specimen_that_misbehaves_at_more_moments(tmp_path, whole, what):
    for moment in MOMENTS[::2]:
        (tmp_path / str(moment)).mkdir()
        misbehaved(tmp_path / str(moment), whole, what, 10 * moment + moment % 10)


# --- the recorder alone ---------------------------------------------------------------------------------------------


@pytest.mark.quick
def test_a_recording_is_whole_at_any_moment(tmp_path):
    rows = np.random.default_rng(1).normal(size=(500, 40))
    recorder = Recorder(tmp_path / "a.h5", {"what": "rows"}, 40)
    for count, row in enumerate(rows):
        recorder.add(row)
        if count % 50 == 0:
            about, found = recorded(tmp_path / "a.h5")
            np.testing.assert_array_equal(found, rows[: count + 1])
            assert about == {"what": "rows"}
    recorder.close()
    np.testing.assert_array_equal(recorded(tmp_path / "a.h5")[1], rows)
    recorder.remove()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.quick
def test_rows_that_move_to_the_journal_while_it_is_read_are_seen(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "structid.hybrid.recording.recorder.BLOCK", 60.0
    )  # rows move when this test says so, not by themselves
    store = tmp_path / "a.h5"
    rows = np.random.default_rng(2).normal(size=(30, 3))
    recorder = Recorder(store, {}, 3)
    following = Following(store)

    def then_moves(read):
        def reading(*arguments):
            found = read(*arguments)
            found = list(found) if isinstance(found, Iterator) else found
            recorder._take()
            return found

        return reading

    monkeypatch.setattr(Journal, "entries_after", staticmethod(then_moves(Journal.entries_after)))
    monkeypatch.setattr(Journal, "read", then_moves(Journal.read))
    monkeypatch.setattr(recorder_module, "_rows_left_in", then_moves(recorder_module._rows_left_in))
    for first in (0, 10, 20):
        for row in rows[first : first + 5]:
            recorder.add(row)
        np.testing.assert_array_equal(following.new_rows(), rows[first : first + 5])
        for row in rows[first + 5 : first + 10]:
            recorder.add(row)
        np.testing.assert_array_equal(recorded(store)[1], rows[: first + 10])
        following.new_rows()
    recorder.close()


@pytest.mark.quick
def test_a_disk_that_fills_up_ends_it_and_loses_nothing(tmp_path, monkeypatch):
    recorder = Recorder(tmp_path / "a.h5", {}, 3)

    def full(self, arrays):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("structid.core.journal.Journal.append", full)
    count = 0
    with pytest.raises(RecordingError, match="No space left on device"):
        for count in range(10_000):
            recorder.add(np.full(3, float(count)))
            time.sleep(0.002)
    recorder.close()
    found = recorded(tmp_path / "a.h5")[1]
    np.testing.assert_array_equal(found[:, 0], np.arange(count + 1.0))


@pytest.mark.quick
def test_a_disk_that_cannot_keep_up_ends_it(tmp_path, monkeypatch):
    monkeypatch.setattr("structid.hybrid.recording.recorder.TAIL_ROOM", 4096)
    monkeypatch.setattr("structid.hybrid.recording.recorder.ROWS_IN_TAIL", 1)
    recorder = Recorder(tmp_path / "a.h5", {}, 100)
    with pytest.raises(RecordingError, match="cannot keep up"):
        for _ in range(1000):
            recorder.add(np.zeros(100))
    recorder.close()
    assert len(recorded(tmp_path / "a.h5")[1]) >= 4


@pytest.mark.quick
def test_a_store_is_never_written_over(tmp_path):
    test = hybrid_tests.test_on(storey(), duration=0.1)
    test.run(tmp_path / "a.h5")
    with pytest.raises(InputError, match="already exists"):
        hybrid_tests.test_on(storey(), duration=0.1).run(tmp_path / "a.h5")


@pytest.mark.quick
def test_no_room_is_found_out_before_anything_moves(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    specimen = storey()
    with pytest.raises(InputError, match=r"No space left on device.*Nothing has moved"):
        hybrid_tests.test_on(specimen, duration=0.1).run(tmp_path / "a.h5")
    assert not specimen.position.any()
    assert list(tmp_path.iterdir()) == []


# --- resuming -------------------------------------------------------------------------------------------------------


def test_a_simulated_test_resumes_to_the_same_bits(processes, whole):
    one = processes(remote=False)
    one.wait_for(40)
    one.client.kill()
    one.client.join()
    result = hybrid_tests.test_on(storey()).run(one.store, resume=True)
    assert result.finished
    np.testing.assert_array_equal(result.coarse.u, whole.coarse.u)
    assert sorted(p.name for p in one.folder.iterdir()) == ["counter", "test.h5"]


def test_another_specimen_is_found_out(processes):
    one = processes(remote=False)
    one.wait_for(20)
    one.client.kill()
    one.client.join()
    with pytest.raises(InputError, match=r"step \d+ differs from the recording"):
        hybrid_tests.test_on(storey(seed=2)).run(one.store, resume=True)


def test_a_test_on_a_structure_is_never_resumed(processes):
    one = processes(remote=False)
    one.wait_for(20)
    one.client.kill()
    one.client.join()
    specimen = storey()
    specimen._description = specimen.describe().model_copy(update={"simulated": False})
    with pytest.raises(InputError, match="never resumed: a damaged structure"):
        hybrid_tests.test_on(specimen).run(one.store, resume=True)
    assert open_hybrid(one.store).steps >= 19
    assert all(path.exists() for path in (journal_of(one.store), *tails_of(one.store)))


@pytest.mark.quick
def test_a_store_reads_as_it_was_written(tmp_path, whole):
    result = hybrid_tests.test_on(storey()).run(tmp_path / "a.h5")
    again = open_hybrid(tmp_path / "a.h5")
    assert str(again) == str(result)
    for name in ("u", "traction", "gap", "pseudo_energy"):
        np.testing.assert_array_equal(getattr(again.coarse, name), getattr(whole.coarse, name))
    np.testing.assert_array_equal(again.moves.measured, whole.moves.measured)
    np.testing.assert_array_equal(again.record.values, whole.record.values)
    assert again.feasibility == result.feasibility
    assert again.description == result.description
    with pytest.raises(InputError, match="no such file"):
        open_hybrid(tmp_path / "b.h5")
