"""Functions of many runs in lanes: JAX's numbers, the same bits whoever is beside a run, and JAX where lanes cannot."""

import ctypes
import logging
import mmap
import multiprocessing
import sys
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from structid.engine.device import over_runs
from structid.engine.lanes import machine
from structid.engine.lanes.in_lanes import InLanes
from structid.engine.lanes.signals import Signals

pytestmark = pytest.mark.quick

RNG = np.random.default_rng(3)
ROWS = RNG.normal(size=(300, 2))


def oscillation(theta, record):
    """x″ = record − a x − b x′ by a plain rule, its history and the sum of its squares."""
    a, b = jnp.exp(theta[:, 0]), jnp.exp(theta[:, 1])

    def step(state, force):
        x, v = state
        v = v + 0.01 * (force - a * x - b * v)
        return (x + 0.01 * v, v), jnp.stack([x, v])

    (x, v), seen = jax.lax.scan(step, (jnp.zeros_like(a), jnp.zeros_like(a)), record)
    return seen, jnp.isfinite(x + v)


RECORD = np.sin(0.1 * np.arange(200))


def test_the_same_as_jax():
    ours, theirs = InLanes(oscillation, (2, 0)), over_runs(oscillation, (2, 0))
    for count in (1, 7, 8, 9, 300):
        (seen, finite), (expected, fine) = ours(ROWS[:count], RECORD), theirs(ROWS[:count], RECORD)
        assert seen.shape == expected.shape == (200, 2, count)
        np.testing.assert_allclose(seen, expected, rtol=1e-12, atol=1e-15)
        assert finite.dtype == bool and (finite == fine).all()
    assert not ours.why_not


def test_another_record_is_another_record():
    ours = InLanes(oscillation, (2, 0))
    first, other = ours(ROWS[:3], RECORD)[0], ours(ROWS[:3], 2.0 * RECORD)[0]
    np.testing.assert_allclose(other, 2.0 * first, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(ours(ROWS[:3], RECORD)[0], first)


def test_another_array_of_the_same_shape_is_not_traced_again():
    traced = []

    def nearness(theta, points):
        traced.append(points.shape)
        return jax.lax.scan(
            lambda total, point: (total + jnp.exp(-((theta[:, 0] - point[0]) ** 2)), None), 0.0 * theta[:, 0], points
        )[0]

    ours = InLanes(nearness, one_array=True)
    for points in (RNG.normal(size=(70, 1)), RNG.normal(size=(70, 1)), RNG.normal(size=(90, 1))):
        expected = np.exp(-((ROWS[:, :1] - points.T) ** 2)).sum(axis=1)
        np.testing.assert_allclose(ours(ROWS, points), expected, rtol=1e-12)
    assert not ours.why_not and traced == [(70, 1), (90, 1)]


def test_a_longer_record_needs_no_other_code():
    ours = InLanes(oscillation, (2, 0))
    texts = {ours.compiled(2, (np.sin(0.1 * np.arange(samples)),)).kernel.text for samples in (200, 3000)}
    assert len(texts) == 1


def test_a_run_that_diverges_is_found_in_its_lane_alone():
    rows = np.tile([[0.0, 0.0]], (16, 1))
    rows[5] = [20.0, 0.0]
    seen, finite = InLanes(oscillation, (2, 0))(rows, np.ones(2000))
    assert (finite == (np.arange(16) != 5)).all()
    assert not np.isfinite(seen[-1, :, 5]).all() and np.isfinite(np.delete(seen, 5, axis=2)).all()


@pytest.mark.parametrize("count", [1, 8, 21])
def test_signals_of_each_run(count):
    """A filter of each run's own signal, with its first sample and a part of its rows taken by themselves."""

    def filtered(theta, signals, gain):
        def step(y, row):
            y = theta[:, 0] * y + gain * row[1]
            return y, y

        return jax.lax.scan(step, signals[0, 0], signals[1:])[1]

    theta, signals = RNG.uniform(0.1, 0.9, (count, 1)), Signals(RNG.normal(size=(count, 50, 2)))
    ours = InLanes(filtered, 1)
    found = ours(theta, np.array(2.0), signals=signals)
    y = signals.values[:, 0, 0]
    for i in range(1, 50):
        y = theta[:, 0] * y + 2.0 * signals.values[:, i, 1]
        np.testing.assert_allclose(found[i - 1], y, rtol=1e-12, atol=1e-15)
    assert not ours.why_not
    np.testing.assert_allclose(
        ours._jax_of_rows(1, signals.shape)(np.hstack([theta, signals.values.reshape(count, -1)]), np.array(2.0)),
        found,
        rtol=1e-12,
        atol=1e-15,
    )


# --- bits -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def alone():
    return InLanes(oscillation, (2, 0))(ROWS, RECORD)[0]


def test_the_same_bits_for_permuted_and_cut_batches(alone):
    order = RNG.permutation(300)
    ours = InLanes(oscillation, (2, 0))
    assert (ours(ROWS[order], RECORD)[0] == alone[..., order]).all()
    assert (np.concatenate([ours(ROWS[:101], RECORD)[0], ours(ROWS[101:], RECORD)[0]], axis=2) == alone).all()


@pytest.mark.parametrize("cores", ["1", "2", "5"])
def test_the_same_bits_on_any_number_of_cores(alone, cores, monkeypatch):
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", cores)
    assert (InLanes(oscillation, (2, 0))(ROWS, RECORD)[0] == alone).all()


@pytest.mark.parametrize("width", [4, 8, 16, 32])
def test_the_same_bits_for_any_number_of_lanes(alone, width, monkeypatch):
    monkeypatch.setattr("structid.engine.lanes.in_lanes.lanes", lambda _: width)
    assert (InLanes(oscillation, (2, 0))(ROWS, RECORD)[0] == alone).all()


def chain_of(masses):
    """Springs in a row under a force: a state of two numbers for each mass."""

    def motion(theta, record):
        def step(state, force):
            x, v = state
            pulled = theta[:, 0] * (jnp.roll(x, 1, 0) - 2.0 * x + jnp.roll(x, -1, 0)) + force
            v = v + 0.01 * pulled
            return (x + 0.01 * v, v), x[-1:]

        nothing = jnp.zeros((masses, theta.shape[0]))
        (x, _), seen = jax.lax.scan(step, (nothing, nothing), record)
        return seen, jnp.isfinite(x.sum(axis=0))

    return motion


@pytest.mark.parametrize(("masses", "times_the_register"), [(2, 2), (16, 1)])
def test_a_large_state_has_one_register_for_each_number(masses, times_the_register):
    ours, theirs = InLanes(chain_of(masses), (2, 0)), over_runs(chain_of(masses), (2, 0))
    assert ours.compiled(1, (RECORD,)).kernel.width == machine.lanes() // 2 * times_the_register
    np.testing.assert_allclose(ours(ROWS[:, :1], RECORD)[0], theirs(ROWS[:, :1], RECORD)[0], rtol=1e-12, atol=1e-15)


# --- threads and processes ------------------------------------------------------------------------------------------


def test_several_threads_at_once(alone):
    ours, found = InLanes(oscillation, (2, 0)), {}
    threads = [threading.Thread(target=lambda i=i: found.update({i: ours(ROWS, RECORD)[0]})) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8 and all((f == alone).all() for f in found.values())


def _in_child(queue, function):
    queue.put(function(ROWS, RECORD)[0])


@pytest.mark.filterwarnings("ignore:.*fork.*")
def test_a_forked_process_starts_its_own_threads(alone):
    """JAX forbids it after its own threads have started; the lanes alone allow it."""
    ours = InLanes(oscillation, (2, 0))
    ours(ROWS, RECORD)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_in_child, args=(queue, ours))
    child.start()
    assert (queue.get(timeout=60) == alone).all()
    child.join(timeout=60)
    assert child.exitcode == 0


# --- what has no vector code ----------------------------------------------------------------------------------------


def test_jax_does_what_lanes_cannot_and_says_so_once(caplog):
    def ranked(theta, record):
        seen, finite = oscillation(theta, record)
        return jnp.sort(seen, axis=0), finite

    ours = InLanes(ranked, (2, 0))
    with caplog.at_level(logging.INFO, logger="structid"):
        found = [ours(ROWS[:5], RECORD)[0] for _ in range(3)]
    assert ours.why_not and len([r for r in caplog.records if ours.why_not in r.message]) == 1
    np.testing.assert_array_equal(found[0], over_runs(ranked, (2, 0))(ROWS[:5], RECORD)[0])


def test_what_has_no_vector_code_before_the_loop_is_done_by_jax():
    def modal(theta, record):
        matrix = jnp.eye(2) * jnp.exp(theta)[:, None, :] + 0.1
        lowest = jnp.linalg.eigvalsh(matrix)
        return oscillation(jnp.log(lowest), record)

    ours, theirs = InLanes(modal, (2, 0)), over_runs(modal, (2, 0))
    np.testing.assert_allclose(ours(ROWS[:11], RECORD)[0], theirs(ROWS[:11], RECORD)[0], rtol=1e-10, atol=1e-14)
    assert not ours.why_not


def test_a_function_without_a_loop_is_left_to_jax():
    ours = InLanes(lambda theta: theta.sum(axis=1))
    np.testing.assert_allclose(ours(ROWS), ROWS.sum(axis=1), rtol=1e-14)
    assert ours.why_not == "no loop over time"


def test_without_llvm_everything_runs_on_jax(alone, monkeypatch):
    monkeypatch.setenv("STRUCTID_ENGINE", "jax")
    machine.why_not.cache_clear()
    try:
        ours = InLanes(oscillation, (2, 0))
        np.testing.assert_allclose(ours(ROWS, RECORD)[0], alone, rtol=1e-12, atol=1e-15)
        assert machine.engine() == "jax" and "STRUCTID_ENGINE" in ours.why_not
    finally:
        machine.why_not.cache_clear()


# --- the cache ------------------------------------------------------------------------------------------------------


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    machine._machine.cache_clear()
    return tmp_path / "structid" / "lanes"


def test_compiled_once_and_read_again(empty_cache, alone, monkeypatch):
    InLanes(oscillation, (2, 0))(ROWS, RECORD)
    (file,) = empty_cache.glob("*.o")
    machine._machine.cache_clear()
    monkeypatch.setattr(machine._Machine, "object_code", lambda *_: pytest.fail("compiled again"))
    assert (InLanes(oscillation, (2, 0))(ROWS, RECORD)[0] == alone).all() and file.exists()


@pytest.mark.parametrize("broken", [b"", b"x" * 200, None])
def test_a_broken_file_is_made_again(empty_cache, alone, broken):
    InLanes(oscillation, (2, 0))(ROWS, RECORD)
    (file,) = empty_cache.glob("*.o")
    whole = file.read_bytes()
    file.write_bytes(whole[:-100] if broken is None else broken)
    machine._machine.cache_clear()
    assert (InLanes(oscillation, (2, 0))(ROWS, RECORD)[0] == alone).all()
    assert file.read_bytes() == whole


def test_a_cache_that_cannot_be_written_is_no_error(tmp_path, alone, monkeypatch):
    (tmp_path / "structid").write_text("a file where the folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    machine._machine.cache_clear()
    assert (InLanes(oscillation, (2, 0))(ROWS, RECORD)[0] == alone).all()
    assert [file.name for file in tmp_path.iterdir()] == ["structid"]


# --- memory ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def no_room_side_by_side():
    """One free page, and 3 GB of memory in use between it and the next."""
    kept = []

    def lower(size, flags=0):
        kept.append(mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | flags))
        return ctypes.addressof(ctypes.c_char.from_buffer(kept[-1]))

    def nothing_free_above():
        bound = lower(3 << 30, flags=0x4000)  # not reserved
        for size in (1 << 26, 1 << 20, 1 << 16, 1 << 12):
            while lower(size) > bound:
                pass

    nothing_free_above()
    hole = mmap.mmap(-1, mmap.PAGESIZE)
    nothing_free_above()
    hole.close()
    yield
    for each in kept:
        each.close()


@pytest.mark.skipif(sys.platform != "linux", reason="memory is filled from above")
def test_code_and_constants_lie_side_by_side(no_room_side_by_side, alone):
    machine._machine.cache_clear()
    assert (InLanes(oscillation, (2, 0))(ROWS, RECORD)[0] == alone).all()
