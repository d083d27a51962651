"""Models in workers: forked, spawned, threads, Dask. The same bits as alone, and one core for each process."""

import concurrent.futures
import dataclasses
import multiprocessing

import cloudpickle
import numpy as np
import pytest

import structid as si
from oscillators import DEGRADING
from structid.core.cores import cores_to_use

THETA = np.random.default_rng(1).uniform(7e6, 8e6, (40, 1))


def responses(rows):
    """Histories of some oscillators, and how many cores made them."""
    record = si.GroundMotion(np.sin(0.1 * np.arange(400)), 0.02)
    model = si.BoucWen(**DEGRADING | {"stiffness": None}, free=("stiffness",))
    return model.simulate(rows, record).values, cores_to_use()


@pytest.fixture(scope="module")
def alone():
    return responses(THETA)[0]


@pytest.mark.filterwarnings("ignore:.*fork.*")
@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_worker_processes(start, alone):
    with concurrent.futures.ProcessPoolExecutor(2, multiprocessing.get_context(start)) as pool:
        parts = list(pool.map(responses, np.split(THETA, 4), timeout=120))
    np.testing.assert_array_equal(np.concatenate([values for values, _ in parts]), alone)
    assert [cores for _, cores in parts] == [1, 1, 1, 1]


def test_models_and_posteriors_that_have_run_can_be_sent(short_posterior):
    phi = short_posterior.initial(5, np.random.default_rng(1))
    density = short_posterior.evaluate(phi)[0]
    sent = cloudpickle.loads(cloudpickle.dumps(short_posterior))
    assert sent.in_lanes
    np.testing.assert_array_equal(sent.evaluate(phi)[0], density)
    record, model = short_posterior.observations[0].record, short_posterior.model
    theta = short_posterior.model_parameters(short_posterior.bijection(phi)[0])
    values = model.simulate(theta, record).values
    np.testing.assert_array_equal(cloudpickle.loads(cloudpickle.dumps(model)).simulate(theta, record).values, values)


def test_the_same_record_is_not_compiled_again(short_posterior, monkeypatch):
    record, model = short_posterior.observations[0].record, short_posterior.model
    theta = np.tile([7.5e6, 60.0, 0.5, 0.05], (3, 1))
    first = model.simulate(theta, record).values
    monkeypatch.setattr("structid.engine.lanes.in_lanes.kernel", lambda *_: pytest.fail("compiled again"))
    same = dataclasses.replace(record)
    np.testing.assert_array_equal(model.simulate(theta, same).values, first)


def test_threads(alone):
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(responses, np.split(THETA, 8)))
    np.testing.assert_array_equal(np.concatenate([values for values, _ in parts]), alone)


def test_dask_workers(alone):
    distributed = pytest.importorskip("distributed")
    settings = dict(n_workers=2, threads_per_worker=2, dashboard_address=None)
    with distributed.LocalCluster(**settings) as cluster, distributed.Client(cluster) as client:
        parts = client.gather(client.map(responses, np.split(THETA, 8)))
    np.testing.assert_array_equal(np.concatenate([values for values, _ in parts]), alone)
    assert {cores for _, cores in parts} == {1}
