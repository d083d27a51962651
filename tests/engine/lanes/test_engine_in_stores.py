"""What one engine began, another does not go on with unseen: last digits differ, and a store says which wrote it."""

import dataclasses

import numpy as np
import pytest

import structid as si
from structid.core.errors import StoreMismatchError
from structid.engine.lanes import machine

SETTINGS = dict(walkers=16, ensembles=2, discard=0.0)
WITHOUT_LANES = pytest.mark.skipif(bool(machine.why_not()), reason="no lanes here")

pytestmark = WITHOUT_LANES


@pytest.fixture
def use(monkeypatch):
    """Choose an engine, as a user does in the shell before a new process starts."""

    def chosen(engine):
        monkeypatch.setenv("STRUCTID_ENGINE", engine)
        machine.why_not.cache_clear()

    yield chosen
    machine.why_not.cache_clear()


def test_chains_go_on_with_the_engine_that_began_them(tmp_path, short_posterior, use):
    def steps(count):
        afresh = short_posterior._like()  # what has been compiled stays with the engine that it was compiled for
        return si.sample(afresh, si.AIES(**SETTINGS, steps=count), seed=4, store=tmp_path / "chains.h5").history

    use("jax")
    first = steps(10)
    use("")
    with pytest.raises(
        StoreMismatchError, match=r"engine is 'jax' in the store, 'lanes \d+' here.*STRUCTID_ENGINE=jax"
    ):
        steps(20)
    use("jax")
    np.testing.assert_array_equal(steps(20)[:10], first)


def test_true_runs_of_another_engine_are_kept_when_asked(tmp_path, study_space, short_posterior, short_record, use):
    path, design = tmp_path / "runs.h5", study_space.sample(5, seed=1)

    def runs(**options):
        afresh = dataclasses.replace(short_posterior.model)
        return si.Campaign(afresh, short_record, design, path).run(**options).values

    use("jax")
    first = runs()
    use("")
    with pytest.raises(StoreMismatchError, match=r"engine is.*--adopt"):
        runs()
    np.testing.assert_array_equal(runs(adopt=True), first)
    path.unlink()
    # A history passes through zero: last digits are counted from its largest value.
    np.testing.assert_allclose(runs(), first, rtol=0.0, atol=1e-12 * np.abs(first).max())
