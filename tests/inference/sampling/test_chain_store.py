"""Chains on disk: read, continued from any length to the same bits, refused when they are another's."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError, StoreMismatchError
from structid.inference.target import LogDensity
from targets import banana, gaussian


def test_a_store_is_read_continued_and_refused(tmp_path):
    store = tmp_path / "chains.h5"
    settings = dict(walkers=12, ensembles=2, discard=0.0)
    first = si.sample(gaussian(), si.AIES(**settings, steps=100), seed=4, store=store)
    assert store.exists() and not store.with_name("chains.h5.journal").exists()
    again = si.sample(gaussian(), si.AIES(**settings, steps=100), seed=4, store=store)
    np.testing.assert_array_equal(again.history, first.history)
    longer = si.sample(gaussian(), si.AIES(**settings, steps=250), seed=4, store=store)
    fresh = si.sample(gaussian(), si.AIES(**settings, steps=250), seed=4)
    np.testing.assert_array_equal(longer.history, fresh.history)
    before = store.read_bytes()
    with pytest.raises(StoreMismatchError, match="seed"):
        si.sample(gaussian(), si.AIES(**settings, steps=100), seed=5, store=store)
    with pytest.raises(StoreMismatchError, match=r"names|target"):
        si.sample(banana(), si.AIES(**settings, steps=100), seed=4, store=store)
    assert store.read_bytes() == before


@pytest.mark.parametrize(("first", "then"), [(120, 250), (20, 30), (120, 110), (50, 70)])
def test_a_store_continues_from_any_length_to_the_same_bits(tmp_path, first, then):
    settings = dict(walkers=12, ensembles=2, discard=0.0)
    store = tmp_path / "chains.h5"
    si.sample(gaussian(), si.AIES(**settings, steps=first), seed=4, store=store)
    longer = si.sample(gaussian(), si.AIES(**settings, steps=then), seed=4, store=store)
    fresh = si.sample(gaussian(), si.AIES(**settings, steps=then), seed=4)
    assert len(longer.history) == then
    np.testing.assert_array_equal(longer.history, fresh.history)
    again = si.sample(gaussian(), si.AIES(**settings, steps=then), seed=4, store=store)
    np.testing.assert_array_equal(again.history, fresh.history)


def test_a_store_knows_its_function_and_its_start(tmp_path):
    start = lambda n, rng: rng.standard_normal((n, 2))  # noqa: E731
    first = LogDensity(lambda x: -0.5 * (x**2).sum(1), "ab", start)
    other = LogDensity(lambda x: -0.6 * (x**2).sum(1), "ab", start)
    settings = si.AIES(walkers=12, steps=50, ensembles=2)
    points = np.random.default_rng(0).standard_normal((30, 2))
    si.sample(first, settings, seed=1, store=tmp_path / "a.h5")
    with pytest.raises(StoreMismatchError, match="target"):
        si.sample(other, settings, seed=1, store=tmp_path / "a.h5")
    with pytest.raises(StoreMismatchError, match="start"):
        si.sample(first, settings, seed=1, store=tmp_path / "a.h5", start=points)


def test_a_run_that_cannot_begin_leaves_nothing(tmp_path):
    with pytest.raises(InputError):
        si.sample(gaussian(), si.AIES(walkers=8, steps=10), seed=1, store=tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []
