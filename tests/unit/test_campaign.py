"""Campaigns: the same runs whoever does them, stored once and for all, added to, tried again, refused when they do not fit."""

import concurrent.futures
import multiprocessing
import os
import resource
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import xarray

import solvers
import structid as si
from processes import alive, wait_until_gone
from structid.campaign import parts
from structid.campaign import store as stores
from structid.campaign.executors import kept_open, mapping
from structid.errors import CampaignStoppedError, InputError, Status, StoreError, StoreMismatchError
from structid.reasons import general_reason

RECORD = si.GroundMotion(np.sin(np.arange(300) * 0.05), 0.01, "sine")
SHORT = si.GroundMotion(np.cos(np.arange(200) * 0.05), 0.02, "cosine")
SPACE = si.ParameterSpace(a=si.Uniform(0.0, 1.0), b=si.Normal(5.0, 1.0, low=1.0, unit="Hz"))


def wave_model(function=solvers.wave, **settings):
    return si.CallableModel(function, SPACE.names, ("velocity",), **settings)


@pytest.fixture(scope="module")
def expected():
    """What an undisturbed serial campaign gives."""
    return si.Campaign(wave_model(solvers.noisy_wave), RECORD, SPACE.sample(40, seed=1)).run()


# --- executors ------------------------------------------------------------------------------------------------------


def dask_client():
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50
    )
    return cluster, distributed.Client(cluster, set_as_default=False)


@pytest.fixture(params=["serial", "processes", "processes:3", "threads", "a process pool", "dask"])
def executor(request):
    match request.param:
        case "threads":
            with concurrent.futures.ThreadPoolExecutor(2) as pool:
                yield pool
        case "a process pool":
            with concurrent.futures.ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
                yield pool
        case "dask":
            cluster, client = dask_client()
            with cluster, client:
                yield client
        case name:
            yield name


def test_the_result_does_not_depend_on_the_executor(executor, expected, tmp_path):
    runs = si.Campaign(
        wave_model(solvers.noisy_wave), RECORD, SPACE.sample(40, seed=1), store=tmp_path / "runs.h5"
    ).run(executor)
    np.testing.assert_array_equal(runs.values, expected.values)
    np.testing.assert_array_equal(runs.design.values, expected.design.values)
    assert runs.done.all() and (runs.seconds > 0).all()


def test_an_executor_as_a_map(executor):
    with mapping(executor) as spread:
        found = wave_model().simulate(np.array([[0.5, 3.0], [0.7, 4.0], [0.1, 2.0]]), RECORD, map=spread)
    np.testing.assert_array_equal(found.values[1, :, 0], solvers.wave({"a": 0.7, "b": 4.0}, RECORD))


def test_workers_that_are_kept_open_start_once_and_end_with_the_last():
    model = wave_model(solvers.own_process)

    def workers_of(executor, seed):
        runs = si.Campaign(model, RECORD, SPACE.sample(3, seed=seed)).run(executor)
        return set(runs.values[:, 0, 0].astype(int))

    with kept_open(model, "serial") as workers:
        (worker,) = workers_of(workers, 1)
        assert workers_of(workers, 2) == {worker}
        with mapping(workers) as spread:
            assert model.simulate(np.array([[0.5, 3.0]]), RECORD, map=spread).values[0, 0, 0] == worker
        assert alive(worker)
    wait_until_gone([worker])
    assert workers_of("serial", 1) != {worker}


def test_a_campaign_that_is_stopped_leaves_no_worker_that_was_kept_open(tmp_path):
    model, path = wave_model(solvers.own_process), tmp_path / "runs.h5"

    def stop(done, total, failed):
        if done > 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), kept_open(model, "processes:2") as workers:
        si.Campaign(model, RECORD, SPACE.sample(200, seed=1), store=path).run(workers, progress=stop)
    stored = si.open_runs(path)
    wait_until_gone(set(stored.values[stored.done, 0, 0].astype(int)))
    assert si.Campaign(model, RECORD, SPACE.sample(200, seed=1), store=path).run("processes:2").done.all()


@pytest.mark.parametrize("wrong", ["process", "processes:0", "processes:many", 7])
def test_unknown_executors_are_refused(wrong):
    with pytest.raises(InputError, match="tcp://scheduler:8786"):
        si.Campaign(wave_model(), RECORD, SPACE.sample(2, seed=1)).run(wrong)


def test_a_scheduler_that_is_not_there_is_one_line_within_ten_seconds():
    pytest.importorskip("distributed")
    import time

    began = time.monotonic()
    with pytest.raises(InputError, match=r"no Dask scheduler answers there") as caught:
        si.Campaign(wave_model(), RECORD, SPACE.sample(2, seed=1)).run("tcp://127.0.0.1:9")
    assert time.monotonic() - began < 10.0
    assert "\n" not in str(caught.value)


def test_a_broken_process_pool_stops_with_a_word_and_what_is_stored_stays(tmp_path):
    path = tmp_path / "runs.h5"
    design = SPACE.sample(20, seed=1)
    with concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:

        def told(done, total, failed):
            if done >= 5:
                for process in list(pool._processes.values()):
                    process.kill()

        with pytest.raises(
            CampaignStoppedError,
            match=r"executor (broke down|takes no more runs).*of 20 runs are stored.*Run the same campaign again",
        ):
            si.Campaign(wave_model(), RECORD, design, path).run(pool, progress=told)
    half = si.open_runs(path)
    assert 5 <= half.done.sum() < 20 and half.counts[Status.PENDING] == 20 - half.done.sum()
    runs = si.Campaign(wave_model(), RECORD, design, path).run()
    assert runs.done.all()
    np.testing.assert_array_equal(half.values[half.done], runs.values[half.done])


# --- the store ------------------------------------------------------------------------------------------------------


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


def calls(model, tmp_path, monkeypatch):
    """A model that notes every call, and how many there were."""
    monkeypatch.setenv("CALLS", str(tmp_path / "calls"))
    return lambda: len((tmp_path / "calls").read_text().splitlines()) if (tmp_path / "calls").exists() else 0


def test_points_added_later_redo_nothing(tmp_path, monkeypatch):
    count = calls(None, tmp_path, monkeypatch)
    path, model = tmp_path / "runs.h5", wave_model(solvers.logged_wave)
    first, more = SPACE.sample(6, seed=1), SPACE.sample(4, seed=2)
    early = si.Campaign(model, RECORD, first, path).run()
    assert count() == 6
    si.Campaign(model, RECORD, first, path).run()
    assert count() == 6
    early_values = early.values
    both = si.Design(np.vstack([more.values[:2], first.values, more.values[2:]]), SPACE)
    runs = si.Campaign(model, RECORD, both, path).run()
    assert count() == 10
    np.testing.assert_array_equal(runs.values[2:8], early_values)
    np.testing.assert_array_equal(runs.design.values, both.values)
    with pytest.raises(StoreMismatchError, match="10 runs at points that this design of 3 lacks"):
        si.Campaign(model, RECORD, SPACE.sample(3, seed=9), path).run()
    np.testing.assert_array_equal(si.open_runs(path).values, runs.values)


def test_points_that_repeat_are_runs_of_their_own(tmp_path, monkeypatch):
    count = calls(None, tmp_path, monkeypatch)
    twice = si.Design(np.repeat(SPACE.sample(3, seed=1).values, 2, axis=0), SPACE)
    runs = si.Campaign(wave_model(solvers.logged_wave), RECORD, twice, tmp_path / "r.h5").run()
    assert count() == 6 and runs.done.all()


def test_failed_runs_are_tried_again_when_asked(tmp_path, monkeypatch):
    monkeypatch.setenv("MARKS", str(tmp_path))
    path, model, design = tmp_path / "runs.h5", wave_model(solvers.fails_once), SPACE.sample(5, seed=1)
    assert si.Campaign(model, RECORD, design, path).run().counts[Status.FAILED] == 5
    assert si.Campaign(model, RECORD, design, path).run().counts[Status.FAILED] == 5  # not by itself
    again = si.Campaign(model, RECORD, design, path).run(retry=True)
    assert again.done.all() and set(again.attempts) == {2}
    for mark in tmp_path.glob("0.*"):
        mark.unlink()
    at_once = si.Campaign(model, RECORD, design).run(attempts=2)
    assert at_once.done.all() and set(at_once.attempts) == {2}
    np.testing.assert_array_equal(at_once.values, again.values)


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
    with pytest.raises(InputError, match="holds no runs"):
        si.Campaign(wave_model(), RECORD, SPACE.sample(2, seed=1), tmp_path / "thesis.h5").run()
    assert (tmp_path / "thesis.h5").read_text() == "my thesis"
    with pytest.raises(InputError, match="no such store"):
        si.open_runs(tmp_path / "nowhere.h5")


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


def test_a_full_disk_stops_the_campaign_and_loses_nothing(tmp_path):
    """A limit on the size of files stands for the disk: the journal's growth fails in the middle of a run's entry."""
    script = tmp_path / "fill.py"
    script.write_text(
        textwrap.dedent("""
        import resource, sys, signal, numpy as np, structid as si, test_campaign as t
        from structid.errors import StoreError
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
    here = Path(__file__).parent
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(here), str(here.parent)]))
    path = tmp_path / "runs.h5"
    command = [sys.executable, str(script), str(path)]
    full = subprocess.run([*command, "40000"], capture_output=True, text=True, env=environment)
    assert full.returncode == 7, full.stderr
    assert "there is no room left" in full.stdout and "run the same campaign again" in full.stdout
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
    with pytest.raises(StoreError, match="They are safe in its parts"):
        si.Campaign(wave_model(), RECORD, design, path).run()
    assert si.open_runs(path).done.all()
    monkeypatch.undo()
    assert si.Campaign(wave_model(), RECORD, design, path).run().done.all()
    assert not parts.parts_of(path).exists()


# --- kinds of model, several records --------------------------------------------------------------------------------


def test_built_in_models_run_in_batches(tmp_path, short_record, study_space):
    model = si.BoucWen(mass=12_000.0, damping_ratio=0.03, free=study_space.names)
    design = study_space.sample(300, seed=1)
    told = []
    runs = si.Campaign(model, short_record, design, tmp_path / "r.h5").run(progress=lambda *a: told.append(a))
    np.testing.assert_array_equal(runs.values, model.simulate(design, short_record).values)
    assert told == [(0, 300, 0), (256, 300, 0), (300, 300, 0)]


def test_a_built_in_model_that_diverges_is_a_row(short_record):
    space = si.ParameterSpace(stiffness=si.Uniform(1e6, 1e12))
    model = si.BoucWen(mass=1.0, damping_ratio=0.03, alpha=0.1, beta=60.0, gamma=60.0, free=space.names, substeps=1)
    runs = si.Campaign(model, short_record, si.Design(np.array([[1e2], [9e11]]), space)).run()
    assert runs.status.tolist() == [Status.DONE, Status.DIVERGED]
    assert "not finite from" in runs.reasons[1] and runs.failure_time[1] > 0


def test_several_records_of_different_lengths(tmp_path):
    campaign = si.Campaign(
        wave_model(), [RECORD, SHORT], SPACE.sample(7, seed=1), tmp_path / "r.h5", assignment="cycle"
    )
    runs = campaign.run("processes")
    assert runs.record_of_run.tolist() == [0, 1, 0, 1, 0, 1, 0]
    assert np.isnan(runs.values[1, 200:]).all() and np.isfinite(runs.values[0]).all()
    some = runs.on("cosine")
    histories = some.histories()
    assert histories.dt == 0.02 and histories.values.shape == (3, 200, 1)
    point = dict(zip(SPACE.names, runs.design.values[3], strict=True))
    np.testing.assert_array_equal(histories.values[1, :, 0], solvers.wave(point, SHORT))
    with pytest.raises(InputError, match="different steps or lengths"):
        runs.histories()
    again = si.open_runs(tmp_path / "r.h5")
    assert [r.name for r in again.records] == ["sine", "cosine"] and len(again.records[1]) == 200
    named = si.Campaign(wave_model(), [RECORD, SHORT], SPACE.sample(2, seed=1), assignment=["cosine", "sine"]).run()
    assert named.record_of_run.tolist() == [1, 0]


@pytest.mark.parametrize("assignment", [None, "all", [0, 1], [0, 1, 2], ["sine", "cosine", "tangent"]])
def test_assignments_that_say_too_little(assignment):
    with pytest.raises(InputError, match="assignment"):
        si.Campaign(wave_model(), [RECORD, SHORT], SPACE.sample(3, seed=1), assignment=assignment)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: si.Campaign(wave_model(), RECORD, np.ones((3, 2))), "a Design"),
        (lambda: si.Campaign(wave_model(), RECORD, SPACE.sample(1, seed=1)[:0]), "no points"),
        (lambda: si.Campaign(wave_model(), [], SPACE.sample(2, seed=1)), "GroundMotion"),
        (lambda: si.Campaign(wave_model(), RECORD, SPACE.sample(2, seed=1)).run(attempts=0), "1 or more"),
        (lambda: si.Campaign(si.CallableModel(len, ("k",), ("v",)), RECORD, SPACE.sample(2, seed=1)), "no prior"),
    ],
)
def test_bad_campaigns_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


# --- failures and reading -------------------------------------------------------------------------------------------


def test_a_badly_behaved_solver_ends_with_exact_counts(tmp_path):
    """10 % crash, 5 % hang, 5 % diverge: a Latin hypercube of a thousand points has exactly that many of each."""
    design = SPACE.sample(1000, seed=3)
    model = wave_model(solvers.badly_behaved, time_limit=0.25)
    runs = si.Campaign(model, RECORD, design, tmp_path / "r.h5").run("processes")
    assert runs.counts == {
        Status.DONE: 800, Status.DIVERGED: 50, Status.FAILED: 100, Status.TIMED_OUT: 50, Status.PENDING: 0,
    }  # fmt: skip
    a = design.values[:, 0]
    np.testing.assert_array_equal(runs.status == Status.FAILED, a < 0.10)
    np.testing.assert_array_equal(runs.status == Status.TIMED_OUT, (a >= 0.10) & (a < 0.15))
    reasons = dict(runs.failures)
    assert reasons["killed by signal 11 (SIGSEGV)"] == 100 and reasons["not finite from … s on"] == 50
    assert "800 done, 50 diverged, 100 failed, 50 timed out" in str(runs)
    figure = runs.plot()
    assert "failed (100)" in [t.get_text() for t in figure.axes[1].get_legend().get_texts()]


def test_runs_are_read_as_they_are_needed(tmp_path):
    runs = si.Campaign(wave_model(), RECORD, SPACE.sample(25, seed=1), tmp_path / "r.h5").run()
    whole = runs.values
    np.testing.assert_array_equal(np.concatenate([b.values for b in runs.batches(7)]), whole)
    np.testing.assert_array_equal(runs[[5, 3, 5]].values, whole[[5, 3, 5]])
    np.testing.assert_array_equal(runs[::3][1:4].values, whole[[3, 6, 9]])
    np.testing.assert_array_equal(runs[runs.design.values[:, 0] > 0.5].values, whole[runs.design.values[:, 0] > 0.5])
    assert len(runs[4]) == 1 and runs.histories().channels == ("velocity",)
    model = wave_model(isolated=False)
    direct = si.Runs.from_histories(runs.design, model.simulate(runs.design, RECORD), RECORD)
    np.testing.assert_array_equal(direct.values, whole)


def test_ctrl_c_says_how_to_go_on(tmp_path):
    path = tmp_path / "r.h5"

    def interrupted(done, total, failed):
        if done >= 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match=r"[3-8] of 9 runs are stored\. Run the same campaign again"):
        si.Campaign(wave_model(), RECORD, SPACE.sample(9, seed=1), path).run(progress=interrupted)
    assert 3 <= si.open_runs(path).done.sum() < 9
    assert si.Campaign(wave_model(), RECORD, SPACE.sample(9, seed=1), path).run().done.all()


@pytest.mark.parametrize(
    ("reason", "general"),
    [
        ("not finite from 3.41 s on", "not finite from … s on"),
        ("exit code 3; it last said: zero pivot 1.2e-5 in row 17 [kept: /tmp/x/run-1]", None),
        ("killed by signal 11 (SIGSEGV)", "killed by signal 11 (SIGSEGV)"),
        ("it returned 393 rows; wanted 400 rows of v2", "it returned … rows; wanted 400 rows of v2"),
    ],
)
def test_reasons_are_counted_by_kind(reason, general):
    assert general_reason(reason) == (general or "exit code 3; it last said: zero pivot … in row 17")


def test_a_space_comes_back_from_its_plain_words(study_space):
    import json

    space = si.ParameterSpace(
        {("a", "b"): 0.3}, {"c": "a * b"},
        a=si.Gamma(mean=2, sd=1, unit="mm"), b=si.Weibull(mean=3, sd=1, high=9), d=si.Gumbel(mean=0, sd=1),
        e=si.Beta(mean=0.3, sd=0.1), f=si.Uniform(-1, 1),
    )  # fmt: skip
    for one in (space, study_space):
        again = si.ParameterSpace.from_plain(json.loads(json.dumps(one.to_plain())))
        assert again.content_hash == one.content_hash
        np.testing.assert_array_equal(again.sample(9, seed=1).values, one.sample(9, seed=1).values)


# --- what a review found --------------------------------------------------------------------------------------------


def test_whatever_a_solver_prints_can_be_stored(tmp_path):
    space = si.ParameterSpace(a=si.Uniform(0.0, 9.0))
    design = si.Design(np.array([[0.0], [5.0], [1.0], [6.0], [2.0], [3.0], [4.0], [7.0]]), space)
    model = si.CallableModel(solvers.noisy_output, ("a",), ("velocity",))
    runs = si.Campaign(model, RECORD, design, tmp_path / "r.h5").run()
    assert runs.done.tolist() == [True] * 4 + [False] * 3 + [True]
    assert runs.reasons[4].startswith("not a text; it last said: junk � �[31m")
    assert runs.reasons[5] == "exit code 1; it last said: here I stop\nno convergence in the first step"
    assert "complex" in runs.reasons[6]


def test_a_run_stopped_between_two_attempts_has_the_second_one(tmp_path, monkeypatch):
    monkeypatch.setenv("MARKS", str(tmp_path))
    path, design = tmp_path / "r.h5", SPACE.sample(5, seed=1)

    def interrupted(done, total, failed):
        if done >= 2:
            raise KeyboardInterrupt

    model = wave_model(solvers.fails_once)
    with pytest.raises(KeyboardInterrupt):
        si.Campaign(model, RECORD, design, path).run(attempts=2, progress=interrupted)
    again = si.Campaign(model, RECORD, design, path).run(attempts=2)
    assert again.done.all()  # also those whose first attempt was stored, and those that were under way


def test_the_state_of_a_solver_is_part_of_its_identity():
    def hashed(function):
        return wave_model(function).content_hash

    assert hashed(solvers.Frame(2.0)) == hashed(solvers.Frame(2.0)) != hashed(solvers.Frame(3.0))
    assert (
        hashed(solvers.Frame(2.0).respond) == hashed(solvers.Frame(2.0).respond) != hashed(solvers.Frame(3.0).respond)
    )


def test_runs_of_a_mended_solver_are_kept_when_asked(tmp_path, monkeypatch):
    path, design = tmp_path / "r.h5", SPACE.sample(6, seed=1)

    def limited(parameters, record):
        if parameters["a"] > 0.5:
            raise ValueError("out of range")
        return solvers.wave(parameters, record)

    before = si.Campaign(wave_model(limited), RECORD, design, path).run()
    assert before.counts[Status.FAILED] == 3
    good = before.values[before.done]
    mended = si.Campaign(wave_model(), RECORD, design, path)
    with pytest.raises(StoreMismatchError, match="--adopt"):
        mended.run(retry=True)
    after = mended.run(retry=True, adopt=True)
    assert after.done.all() and sorted(after.attempts) == [1, 1, 1, 2, 2, 2]
    np.testing.assert_array_equal(after.values[before.done], good)
    assert mended.run().done.all()  # it is this model's store now
    with pytest.raises(StoreMismatchError, match="records is"):
        si.Campaign(wave_model(), RECORD.scale(2.0), design, path).run(adopt=True)


def test_a_design_may_be_added_to_and_a_part_of_it_asked_for(tmp_path):
    path, first, more = tmp_path / "r.h5", SPACE.sample(4, seed=1), SPACE.sample(3, seed=2)
    whole = si.Campaign(wave_model(), RECORD, first + more, path).run()
    content = path.read_bytes()
    part = si.Campaign(wave_model(), RECORD, more, path).run()
    np.testing.assert_array_equal(part.values, whole.values[4:])
    assert path.read_bytes() == content and [p.name for p in tmp_path.iterdir()] == ["r.h5"]
    longer = SPACE.sample(8, seed=3, method="sobol"), SPACE.sample(16, seed=3, method="sobol")
    np.testing.assert_array_equal(longer[1].values[:8], longer[0].values)
    with pytest.raises(InputError, match="the same space"):
        first + si.ParameterSpace(a=si.Uniform(0, 1)).sample(2, seed=1)


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
    with pytest.warns(UserWarning, match="entries after that are not read"):
        assert 0 < si.open_runs(path).done.sum() < stored
    assert journal.with_name("journal.damaged").read_bytes() == bytes(damaged)
    with pytest.warns(UserWarning, match="damaged"):
        assert si.Campaign(wave_model(isolated=False), RECORD, design, path).run().done.all()


def test_a_forked_worker_leaves_its_parents_child_alone():
    model, design = wave_model(), SPACE.sample(4, seed=1)
    assert model.simulate(design, RECORD).done.all()
    with concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        assert si.Campaign(model, RECORD, design).run(pool).done.all()
    assert model.simulate(design, RECORD).done.all()


def test_a_function_that_cannot_be_loaded_there_stops_the_campaign(tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text("def respond(p, r):\n    return r.values\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    import only_here

    model = wave_model(only_here.respond)
    (tmp_path / "only_here.py").unlink()
    shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)
    with pytest.raises(CampaignStoppedError, match="could not be loaded: ModuleNotFoundError"):
        si.Campaign(model, RECORD, SPACE.sample(3, seed=1)).run()


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
