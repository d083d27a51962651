"""The probability of a passage given the data: closed form of a linear oscillator, surrogates that are wrong, failures, kills."""

from __future__ import annotations

import numpy as np
import pytest

import structid as si
from structid.core.errors import StoreMismatchError
from structid.reliability.corrected_share import corrected_share
from structid.reliability.fragility import Fragility, _lognormal

RECORDS = [si.GroundMotion.synthetic(seed=s, duration=6.0) for s in (3, 4, 5)]
SPACE = si.ParameterSpace(stiffness=si.Uniform(4.0, 12.0, unit="kN/mm"), damping_ratio=si.Uniform(0.02, 0.08))


def linear(*channels: str) -> si.BoucWen:
    return si.BoucWen(mass=12_000.0, alpha=1.0, beta=1.0, gamma_ratio=0.0, free=SPACE.names, channels=channels)


@pytest.fixture(scope="module")
def posterior() -> si.Posterior:
    velocity = linear("velocity").simulate(np.array([[8e6, 0.05]]), RECORDS[0]).values[0]
    noise = 0.05 * velocity.std() * np.random.default_rng(1).normal(size=velocity.shape)
    return si.Posterior(SPACE, linear("velocity"), si.Observation(RECORDS[0], velocity + noise))


@pytest.fixture(scope="module")
def draws(posterior: si.Posterior) -> np.ndarray:
    return posterior.space.sample(120, 1, "random").values


def peaks(draws: np.ndarray) -> np.ndarray:
    """Largest displacement at 1 m/s², shape (draw, record)."""
    model = linear("displacement")
    found = [model.simulate(draws[:, :2], r.scale_to_pga(1.0)).channel("displacement") for r in RECORDS]
    return np.stack([np.abs(each).max(axis=1) for each in found], axis=1)


def test_a_linear_oscillator_passes_where_its_peak_times_the_level_does(posterior, draws) -> None:
    at_one = peaks(draws)
    limit, levels = 3.0 * float(np.median(at_one)), [1.0, 2.0, 3.0, 4.0, 6.0]
    found = si.fragility(posterior, draws, RECORDS, "displacement", limit, levels, seed=1)
    expected = at_one[:, :, None] * np.array(levels) > limit
    np.testing.assert_array_equal(found.passed, expected)
    np.testing.assert_allclose(found.probability, expected.mean(axis=(0, 1)), rtol=1e-12)
    scatter = expected.mean(axis=0).std(axis=0, ddof=1) / np.sqrt(3)
    assert (found.error >= scatter - 1e-12).all()
    low, high = found.band()
    shares = expected.mean(axis=1)
    assert (low <= np.median(shares, axis=0)).all() and (high >= np.median(shares, axis=0)).all()
    assert found.true_runs == 120 * 15
    median, dispersion = found.curve
    assert 2.0 < median < 4.5 and 0.05 < dispersion < 1.0
    assert "median" in str(found) and np.isfinite(found.curve_error).all()


def test_a_surrogate_agrees_and_spends_fewer_runs(posterior, draws) -> None:
    limit, levels = 3.0 * float(np.median(peaks(draws))), [2.0, 3.0, 4.0]
    exact = si.fragility(posterior, draws, RECORDS[:2], "displacement", limit, levels, seed=1)
    through = si.fragility(
        posterior,
        draws,
        RECORDS[:2],
        "displacement",
        limit,
        levels,
        surrogate=si.PODKriging(),
        training=40,
        checks=20,
        seed=1,
    )
    assert through.true_runs == 60 * 6
    assert (np.abs(through.of_each - exact.of_each) < 4.0 * through.error_of_each).all()
    assert (np.abs(through.passed - exact.passed).mean(axis=0) < 0.1).all()


def test_a_measured_channel_has_the_models_own_error() -> None:
    """Errors of the model make peaks larger: independent noise is the instrument's, correlated errors are the structure's."""
    velocity = linear("velocity").simulate(np.array([[8e6, 0.05]]), RECORDS[0]).values[0]
    wrong = velocity + 0.3 * velocity.std() * np.sin(30.0 * RECORDS[0].time)[:, None]
    law = si.AR1(variance=float((0.3 * velocity.std()) ** 2), white=1e-9, correlation_time=0.2)
    observed = si.Posterior(SPACE, linear("velocity"), si.Observation(RECORDS[0], wrong), law)
    theta = np.tile([8e6, 0.05], (200, 1))
    motion = RECORDS[1].scale_to_pga(2.0)
    largest = float(np.abs(linear("velocity").simulate(theta[:1], motion).values).max())
    plain = si.fragility(observed, theta, [motion], "velocity", 1.05 * largest, seed=2)
    assert 0.1 < plain.probability[0] < 0.95, "the model alone never passes"


def test_a_wrong_surrogate_is_corrected_without_bias() -> None:
    """A surrogate that says yes to 80 % where 40 % pass: the mean over replicas is right, and so is the error."""
    rng = np.random.default_rng(7)
    found, errors, plain = [], [], []
    for _ in range(2000):
        true = rng.uniform(size=400) < 0.4
        guessed = np.where(true, rng.uniform(size=400) < 0.9, rng.uniform(size=400) < 0.73).astype(float)
        share, error = corrected_share(guessed, guessed[:40], true[:40].astype(float))
        found.append(share)
        errors.append(error)
        plain.append(guessed.mean())
    estimate = np.array(found)
    assert abs(estimate.mean() - 0.4) < 4.0 * estimate.std() / np.sqrt(2000)
    assert abs(np.mean(plain) - 0.4) > 0.35
    assert 0.9 < np.sqrt(np.mean(np.square(errors))) / estimate.std() < 1.3


def test_checks_without_a_disagreement_leave_something_open() -> None:
    found = np.zeros(1000)
    _, error = corrected_share(found, found[:30], found[:30])
    assert error > 0.01
    share, error = corrected_share(found, found[:0], found[:0])
    assert share == 0.0 and 0.0 < error < 1e-3
    assert np.isnan(corrected_share(np.full(5, np.nan), found[:0], found[:0])).all()


def test_a_lognormal_curve_is_found() -> None:
    levels = np.array([1.0, 2.0, 3.0, 4.0, 6.0, 9.0])
    from scipy.stats import norm

    median, dispersion = _lognormal(levels, norm.cdf(np.log(levels / 3.3) / 0.4), 10)
    np.testing.assert_allclose([median, dispersion], [3.3, 0.4], rtol=1e-3)
    assert np.isnan(_lognormal(levels, np.zeros(6), 10)).all()


def test_curves_of_resampled_records_hold_the_true_one() -> None:
    """Records whose thresholds are lognormal: of many studies the standard error of ln θ is that of their scatter."""
    rng, levels, found, told = np.random.default_rng(2), np.linspace(1.0, 8.0, 15), [], []
    for _ in range(20):
        thresholds = 3.0 * np.exp(0.4 * rng.normal(size=25))
        passed = np.tile(levels[None, None] > thresholds[None, :, None], (20, 1, 1)).astype(float)
        each = Fragility("drift", 1.0, levels, ("r",) * 25, passed, passed.mean(axis=0), np.zeros(passed.shape[1:]), 0)
        found.append(np.log(each.curve[0]))
        told.append(each.curve_error[0])
    ratio = np.std(found) / np.median(told)
    assert 0.6 < ratio < 1.6  # ± 16 % of a standard deviation of 20, and the bootstrap's own bias


def fails_if_soft(parameters, record):
    """A linear spring that collapses where it is soft."""
    if parameters["k"] < 0.3:
        raise si.StructureFailedError("it fell", np.zeros(10))
    return {"drift": 0.5 * record.values / parameters["k"]}


def test_a_failure_of_the_structure_is_a_passage() -> None:
    space = si.ParameterSpace(k=si.Uniform(0.1, 2.0))
    model = si.CallableModel(fails_if_soft, free=("k",), channels=("drift",), units={"drift": "m"})
    record = si.GroundMotion(np.sin(np.linspace(0.0, 3.0, 40)), 0.05)
    posterior = si.Posterior(
        space, model, si.Observation(record, 0.5 * record.values, channels=("drift",)), si.IID(1e-4)
    )
    theta = np.array([[0.2], [0.25], [1.0], [1.9]])
    other = si.GroundMotion(np.sin(np.linspace(0.0, 4.0, 40)), 0.05, name="other")
    found = si.fragility(posterior, theta, [other], "drift", 10.0)
    np.testing.assert_array_equal(found.passed[:, 0, 0], [1.0, 1.0, 0.0, 0.0])


def test_where_all_draws_fail_there_is_no_surrogate() -> None:
    space = si.ParameterSpace(k=si.Uniform(0.1, 2.0))
    model = si.CallableModel(fails_if_soft, free=("k",), channels=("drift",), units={"drift": "m"})
    record = si.GroundMotion(np.sin(np.linspace(0.0, 3.0, 40)), 0.05)
    posterior = si.Posterior(
        space, model, si.Observation(record, 0.5 * record.values, channels=("drift",)), si.IID(1e-4)
    )
    theta = np.linspace(0.1, 0.2, 20)[:, None]
    other = si.GroundMotion(np.sin(np.linspace(0.0, 4.0, 40)), 0.05, name="other")
    found = si.fragility(posterior, theta, [other], "drift", 10.0, surrogate=si.PODKriging(), training=10, checks=5)
    assert found.probability[0] == 1.0 and np.isnan(found.passed[15:]).all() and found.error[0] > 0.0
    assert found.band() == (1.0, 1.0)


def test_a_killed_computation_goes_on_to_the_same_numbers(tmp_path, posterior, draws) -> None:
    asked = dict(levels=[1.0, 2.0], seed=3, store=tmp_path / "f.journal")

    def stop(done: int, total: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        si.fragility(posterior, draws[:20], RECORDS[:2], "displacement", 0.02, progress=stop, **asked)
    told: list[int] = []
    again = si.fragility(
        posterior,
        draws[:20],
        RECORDS[:2],
        "displacement",
        0.02,
        progress=lambda done, total: told.append(done),
        **asked,
    )
    assert told == [4], "three of four were done"
    whole = si.fragility(posterior, draws[:20], RECORDS[:2], "displacement", 0.02, levels=[1.0, 2.0], seed=3)
    np.testing.assert_array_equal(again.passed, whole.passed)
    with pytest.raises(StoreMismatchError):
        si.fragility(posterior, draws[:20], RECORDS[:2], "displacement", 0.03, **asked)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (dict(records=[]), "records"),
        (dict(levels=None), "no levels for 3 records"),
        (dict(levels=[1.0, -2.0]), "positive peak"),
        (dict(limit=0.0), "limit"),
        (dict(surrogate=si.PODKriging(), training=100, checks=30), "100 train the surrogate and 30 check it"),
    ],
)
def test_what_cannot_be_asked(posterior, draws, settings, told) -> None:
    asked = dict(records=RECORDS, channel="displacement", limit=0.02, levels=[1.0]) | settings
    with pytest.raises(si.InputError, match=told):
        si.fragility(posterior, draws, **asked)
