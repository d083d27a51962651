"""The store of runs: one file that xarray opens, refused when it does not fit, whole again after a full disk or a power cut."""

import os
import resource
import subprocess
import sys
import textwrap
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray

import solvers
import structid as si
from structid.campaign import parts
from structid.campaign import store as stores
from structid.core.errors import InputError, StoreError, StoreMismatchError
from waves import RECORD, SPACE, wave_model

HELPERS = Path(__file__).parents[1] / "helpers"


@pytest.fixture(scope="module")
def expected():
    """What an undisturbed serial campaign gives."""
    return si.Campaign(wave_model(solvers.noisy_wave), RECORD, SPACE.sample(40, seed=1)).run()


def test_the_store_is_one_file_that_xarray_opens(tmp_path):
    path = tmp_path / "runs.h5"
    runs = si.Campaign(wave_model(), RECORD, SPACE.sample(10, seed=1), path).run()
    assert [p.name for p in tmp_path.iterdir()] == ["runs.h5"]
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        assert data.sizes == {"run": 10, "time": 300, "channel": 1, "parameter": 2, "record": 1}
        np.testing.assert_array_equal(data["values"][3], runs.values[3])
        assert data["parameter"].values.tolist() == ["a", "b"] and data["time"].values[-1] == pytest.approx(2.99)
    again = si.open_runs(path)
    assert again.design.space.content_hash == SPACE.content_hash
    assert again.records[0].content_hash == RECORD.content_hash and isinstance(again.records[0], si.GroundMotion)
    memory = si.Campaign(wave_model(), RECORD, SPACE.sample(10, seed=1)).run().to_xarray()
    for name in ("values", "theta", "status", "excitation", "record_of_run"):
        np.testing.assert_array_equal(memory[name], runs.to_xarray()[name])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda: (wave_model(solvers.noisy_wave), RECORD, SPACE), "model is"),
        (lambda: (wave_model(), RECORD.scale(2.0), SPACE), "records is"),
        (lambda: (wave_model(), RECORD, si.ParameterSpace(a=si.Uniform(0, 2), b=si.Uniform(1, 9))), "space is"),
    ],
)
def test_a_store_of_something_else_is_refused_and_left_alone(tmp_path, change, words):
    path = tmp_path / "runs.h5"
    si.Campaign(wave_model(), RECORD, SPACE.sample(4, seed=1), path).run()
    before = path.read_bytes()
    model, record, space = change()
    with pytest.raises(StoreMismatchError, match=words):
        si.Campaign(model, record, space.sample(4, seed=1), path).run()
    assert path.read_bytes() == before


def test_two_writers_are_one_too_many(tmp_path):
    path, design = tmp_path / "runs.h5", SPACE.sample(4, seed=1)
    held = []

    def told(done, total, failed):
        if done >= 2 and not held:
            with pytest.raises(InputError, match="another process is running this campaign"):
                si.Campaign(wave_model(), RECORD, design, path).run()
            held.append(si.open_runs(path).done.sum())  # reading is allowed all the time

    assert si.Campaign(wave_model(), RECORD, design, path).run(progress=told).done.all()
    assert held and held[0] >= 2


def test_files_that_are_no_stores(tmp_path):
    (tmp_path / "thesis.h5").write_text("my thesis")
    with pytest.raises(InputError, match="it is not an HDF5 file"):
        si.Campaign(wave_model(), RECORD, SPACE.sample(2, seed=1), tmp_path / "thesis.h5").run()
    assert (tmp_path / "thesis.h5").read_text() == "my thesis"
    with pytest.raises(InputError, match="no such store"):
        si.open_runs(tmp_path / "nowhere.h5")


def test_layouts_before_are_read_and_later_ones_refused(tmp_path):
    path, design = tmp_path / "runs.h5", SPACE.sample(2, seed=1)
    done = si.Campaign(wave_model(), RECORD, design, path).run()
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = 1
    np.testing.assert_array_equal(si.open_runs(path).values, done.values)
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = 99
    with pytest.raises(InputError, match=r"runs in layout 99.*Update structid"):
        si.open_runs(path)


def test_many_small_segments_make_the_same_file(tmp_path, monkeypatch, expected):
    monkeypatch.setattr(stores, "SEGMENT_BYTES", 10_000)  # three runs
    numbers = []

    def told(done, total, failed):
        numbers.append(len(parts.segments_of(tmp_path / "runs.h5")))

    runs = si.Campaign(wave_model(solvers.noisy_wave), RECORD, SPACE.sample(40, seed=1), tmp_path / "runs.h5").run(
        progress=told
    )
    assert max(numbers) > 8
    np.testing.assert_array_equal(runs.values, expected.values)


@pytest.mark.slow
def test_a_full_disk_stops_the_campaign_and_loses_nothing(tmp_path):
    """A limit on the size of files stands for the disk: the journal's growth fails in the middle of a run's entry."""
    script = tmp_path / "fill.py"
    script.write_text(
        textwrap.dedent("""
        import resource, sys, signal, numpy as np, structid as si, waves as t
        from structid.core.errors import StoreError
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        if len(sys.argv) > 2:
            resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
        try:
            model = t.wave_model(isolated=False)
            si.Campaign(model, t.RECORD, t.SPACE.sample(40, seed=1), sys.argv[1]).run()
        except StoreError as problem:
            print(problem); sys.exit(7)
        """)
    )
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(HELPERS), *sys.path]))
    path = tmp_path / "runs.h5"
    command = [sys.executable, str(script), str(path)]
    full = subprocess.run([*command, "40000"], capture_output=True, text=True, env=environment)
    assert full.returncode == 7, full.stderr
    assert "the disk is full" in full.stdout and "run the same campaign again" in full.stdout
    half = si.open_runs(path)
    assert 5 <= half.done.sum() < 40
    assert subprocess.run(command, env=environment).returncode == 0
    runs = si.open_runs(path)
    assert runs.done.all()
    np.testing.assert_array_equal(runs.values[half.done], half.values[half.done])
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != 40000  # only the child was limited


def test_no_room_to_put_the_runs_together(tmp_path, monkeypatch):
    monkeypatch.setattr("structid.campaign.run_file.shutil.disk_usage", lambda p: type("Usage", (), {"free": 10})())
    path, design = tmp_path / "runs.h5", SPACE.sample(4, seed=1)
    with pytest.raises(StoreError, match="The runs are safe in the existing files"):
        si.Campaign(wave_model(), RECORD, design, path).run()
    assert si.open_runs(path).done.all()
    monkeypatch.undo()
    assert si.Campaign(wave_model(), RECORD, design, path).run().done.all()
    assert not parts.parts_of(path).exists()


def test_whatever_a_solver_prints_can_be_stored(tmp_path):
    space = si.ParameterSpace(a=si.Uniform(0.0, 9.0))
    design = si.Design(np.array([[0.0], [5.0], [1.0], [6.0], [2.0], [3.0], [4.0], [7.0]]), space)
    model = si.CallableModel(solvers.noisy_output, ("a",), ("velocity",))
    runs = si.Campaign(model, RECORD, design, tmp_path / "r.h5").run()
    assert runs.done.tolist() == [True] * 4 + [False] * 3 + [True]
    assert runs.reasons[4].startswith("not a text; it last said: junk � �[31m")
    assert runs.reasons[5] == "exit code 1; it last said: here I stop\nno convergence in the first step"
    assert "complex" in runs.reasons[6]


def test_a_power_cut_leaves_zeros_or_damage(tmp_path):
    """Zeros at the end are torn off; damage in the middle is told, and nothing is thrown away."""
    path, design = tmp_path / "r.h5", SPACE.sample(40, seed=1)

    def stopped(done, total, failed):
        if done >= 25:
            raise KeyboardInterrupt

    def interrupted():
        with pytest.raises(KeyboardInterrupt):
            si.Campaign(wave_model(isolated=False), RECORD, design, path).run(progress=stopped)

    interrupted()
    journal = parts.parts_of(path) / "journal"
    whole, stored = journal.read_bytes(), si.open_runs(path).done.sum()
    assert stored >= 25
    journal.write_bytes(whole + bytes(4096))
    assert si.open_runs(path).done.sum() == stored
    damaged = bytearray(whole)
    damaged[len(whole) // 2] ^= 1
    journal.write_bytes(damaged)
    with pytest.warns(UserWarning, match="later entries are not read"):
        assert 0 < si.open_runs(path).done.sum() < stored
    assert journal.with_name("journal.damaged").read_bytes() == bytes(damaged)
    with pytest.warns(UserWarning, match="damaged"):
        assert si.Campaign(wave_model(isolated=False), RECORD, design, path).run().done.all()


def test_killed_while_the_parts_are_removed(tmp_path, monkeypatch):
    """Some segments are left beside the finished file; the next ones must not take their names."""
    monkeypatch.setattr(stores, "SEGMENT_BYTES", 10_000)  # three runs
    path, first, more = tmp_path / "r.h5", SPACE.sample(12, seed=1), SPACE.sample(8, seed=2)
    kept = tmp_path / "kept"
    whole_removal = stores.shutil.rmtree

    def half_removed(folder, **settings):
        kept.mkdir()
        for segment in sorted(folder.glob("segment-*"))[1:2]:
            segment.rename(kept / segment.name)
        whole_removal(folder, **settings)

    monkeypatch.setattr(stores.shutil, "rmtree", half_removed)
    before = si.Campaign(wave_model(isolated=False), RECORD, first, path).run().values
    monkeypatch.setattr(stores.shutil, "rmtree", whole_removal)
    parts.parts_of(path).mkdir()
    for segment in kept.iterdir():
        segment.rename(parts.parts_of(path) / segment.name)
    runs = si.Campaign(wave_model(isolated=False), RECORD, first + more, path).run()
    np.testing.assert_array_equal(runs.values[:12], before)
    direct = wave_model(isolated=False).simulate((first + more).values, RECORD)
    np.testing.assert_array_equal(runs.values, direct.values)
