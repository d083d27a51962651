"""Campaigns: which runs are done, tried again, counted and refused, whatever the model and the records."""

import numpy as np
import pytest

import solvers
import structid as si
from structid.core.errors import InputError, Status, StoreMismatchError
from waves import RECORD, SHORT, SPACE, wave_model


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
    with pytest.raises(StoreMismatchError, match="10 stored runs are at points that are not in this design of 3"):
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
    with pytest.raises(InputError, match="different time steps or lengths"):
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


def test_a_badly_behaved_solver_ends_with_exact_counts(tmp_path):
    """10 % crash, 5 % hang, 5 % diverge: a Latin hypercube of two hundred points has exactly that many of each."""
    design = SPACE.sample(200, seed=3)
    model = wave_model(solvers.badly_behaved, time_limit=0.25)
    runs = si.Campaign(model, RECORD, design, tmp_path / "r.h5").run("processes")
    seen = {status: count for status, count in runs.counts.items() if count}
    assert seen == {Status.DONE: 160, Status.DIVERGED: 10, Status.FAILED: 20, Status.TIMED_OUT: 10}
    a = design.values[:, 0]
    np.testing.assert_array_equal(runs.status == Status.FAILED, a < 0.10)
    np.testing.assert_array_equal(runs.status == Status.TIMED_OUT, (a >= 0.10) & (a < 0.15))
    reasons = dict(runs.failures)
    assert reasons["killed by signal 11 (SIGSEGV)"] == 20 and reasons["not finite from 1.5 s on"] == 10
    assert "160 done, 10 diverged, 20 failed, 10 timed out" in str(runs)
    figure = runs.plot()
    assert "failed (20)" in [t.get_text() for t in figure.axes[1].get_legend().get_texts()]


def test_ctrl_c_says_how_to_go_on(tmp_path):
    path = tmp_path / "r.h5"

    def interrupted(done, total, failed):
        if done >= 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match=r"[3-8] of 9 runs are stored\. Run the same campaign again"):
        si.Campaign(wave_model(), RECORD, SPACE.sample(9, seed=1), path).run(progress=interrupted)
    assert 3 <= si.open_runs(path).done.sum() < 9
    assert si.Campaign(wave_model(), RECORD, SPACE.sample(9, seed=1), path).run().done.all()


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
