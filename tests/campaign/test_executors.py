"""Executors: the same runs whoever does them; workers start once, end with their owner, and say so when they cannot."""

import concurrent.futures
import multiprocessing
import shutil

import numpy as np
import pytest

import solvers
import structid as si
from processes import alive, wait_until_gone
from structid.campaign.executors import kept_open, mapping
from structid.core.errors import CampaignStoppedError, InputError, Status
from waves import RECORD, SPACE, wave_model


@pytest.fixture(scope="module")
def expected():
    """What an undisturbed serial campaign gives."""
    return si.Campaign(wave_model(solvers.noisy_wave), RECORD, SPACE.sample(40, seed=1)).run()


def dask_client():
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50
    )
    return cluster, distributed.Client(cluster, set_as_default=False)


@pytest.fixture(scope="module", params=["serial", "processes", "processes:3", "threads", "a process pool", "dask"])
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


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_one_line_within_ten_seconds():
    pytest.importorskip("distributed")
    import time

    began = time.monotonic()
    with pytest.raises(InputError, match=r"no Dask scheduler answers at this address") as caught:
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
            match=r"executor (failed|accepts no more runs).*of 20 runs are stored.*Run the same campaign again",
        ):
            si.Campaign(wave_model(), RECORD, design, path).run(pool, progress=told)
    half = si.open_runs(path)
    assert 5 <= half.done.sum() < 20 and half.counts[Status.PENDING] == 20 - half.done.sum()
    runs = si.Campaign(wave_model(), RECORD, design, path).run()
    assert runs.done.all()
    np.testing.assert_array_equal(half.values[half.done], runs.values[half.done])


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
