"""First passages over a design: closed forms, censored times, what failed runs tell."""

from __future__ import annotations

import numpy as np
import pytest

import structid as si
from structid.core.errors import Status

SPEEDS = np.array([0.5, 1.0, 2.0, 4.0])
"""Of straight lines y = v t."""


def lines(speeds: np.ndarray, duration: float = 1.0, dt: float = 0.01) -> si.Runs:
    """Runs whose channel is v t."""
    space = si.ParameterSpace(speed=si.Uniform(0.1, 10.0))
    record = si.GroundMotion(np.zeros(round(duration / dt) + 1), dt)
    time = record.time
    histories = si.Histories((speeds[:, None] * time)[:, :, None], dt, ("drift",))
    return si.Runs.from_histories(si.Design(speeds[:, None], space), histories, record)


def test_straight_lines_pass_where_they_cross() -> None:
    found = si.passages(lines(SPEEDS), "drift", 0.8)
    np.testing.assert_allclose(found.time, [np.nan, 0.8, 0.4, 0.2], rtol=1e-12)
    np.testing.assert_allclose(found.followed, 1.0)
    share, error = found.share
    assert share == 0.75
    assert error == pytest.approx(np.sqrt(0.75 * 0.25 / 4))


def test_concordance_of_what_orders_times_is_one_or_zero() -> None:
    found = si.passages(lines(SPEEDS), "drift", 0.8)
    assert found.concordance(-SPEEDS) == 1.0
    assert found.concordance(SPEEDS) == 0.0
    assert found.concordance(np.ones(4)) == 0.5


def test_a_run_without_a_passage_tells_that_its_time_is_later() -> None:
    """Leaving it out would lose the pair with the largest difference."""
    found = si.passages(lines(np.array([0.5, 2.0])), "drift", 0.8)
    assert found.concordance(np.array([2.0, 1.0])) == 1.0
    alone = si.passages(lines(np.array([0.5, 0.6])), "drift", 0.8)
    assert np.isnan(alone.concordance(np.array([2.0, 1.0])))


def test_a_structure_that_fails_has_passed_and_another_failure_censors() -> None:
    runs = lines(SPEEDS)
    values = runs.values.copy()
    values[0, 50:], values[1, 50:], values[2] = np.nan, np.nan, np.nan
    status = np.array([Status.STRUCTURE_FAILED, Status.DIVERGED, Status.DIVERGED, Status.DONE])
    histories = si.Histories(values, 0.01, ("drift",), status, np.array([0.5, 0.5, 0.0, np.nan]))
    found = si.passages(si.Runs.from_histories(runs.design, histories, runs.records[0]), "drift", 0.8)
    np.testing.assert_allclose(found.time, [0.5, np.nan, np.nan, 0.2], rtol=1e-12)
    np.testing.assert_allclose(found.followed, [0.5, 0.5, 0.0, 1.0])
    assert found.share[0] == 2 / 3, "the run that never began is none of them"


def test_runs_of_several_records_have_their_own_ends() -> None:
    short, long = lines(SPEEDS[:2], 0.5), lines(SPEEDS[:2], 2.0)
    values = np.full((4, 201, 1), np.nan)
    values[:2, :51], values[2:] = short.values, long.values
    runs = si.Runs(
        short.design + long.design,
        (short.records[0], long.records[0]),
        ("drift",),
        type(short.stored)(values),
        np.zeros(4),
        np.array([0, 0, 1, 1]),
    )
    found = si.passages(runs, "drift", 0.8)
    np.testing.assert_allclose(found.followed, [0.5, 0.5, 2.0, 2.0])
    np.testing.assert_allclose(found.time, [np.nan, np.nan, 1.6, 0.8])


def test_the_product_limit_estimate_knows_of_censored_times() -> None:
    """Exponential times, each followed for a random while: the estimate is within its errors, the plain shares are not."""
    rng = np.random.default_rng(3)
    true, until = rng.exponential(1.0, 4000), rng.uniform(0.2, 2.0, 4000)
    space = si.ParameterSpace(speed=si.Uniform(0.0, 1.0))
    design = si.Design(np.full((4000, 1), 0.5), space)
    found = si.Passages(design, "drift", 1.0, np.where(true < until, true, np.nan), until)
    times = np.array([0.25, 0.5, 1.0, 1.5])
    probability, error = found.distribution(times)
    expected = 1.0 - np.exp(-times)
    assert (np.abs(probability - expected) < 4.0 * error).all()
    naive = np.array([(found.time <= t).mean() for t in times])
    assert np.abs(naive - expected)[-1] > 10.0 * error[-1]


@pytest.mark.parametrize("limit", [0.0, -1.0])
def test_a_limit_must_be_beyond_the_beginning(limit: float) -> None:
    with pytest.raises(si.InputError, match="above every run's initial value"):
        si.passages(lines(SPEEDS), "drift", limit)


def test_a_limit_below_the_displacement_at_rest_is_refused() -> None:
    wall = si.MasonryWall(
        normal_energy=5.5e3,
        normal_strength=1.05e6,
        tangential_energy=4e5,
        tangential_strength=2e6,
        channels=("uy_top_left",),
    )
    found = wall.simulate(np.zeros((1, 0)), si.GroundMotion.synthetic(seed=8).trim(6.0, 6.1))
    with pytest.raises(si.InputError, match=r"Choose a limit above 0\.0025"):
        si.first_passage(found, "uy_top_left", 1e-3)


def test_an_unknown_channel_is_refused() -> None:
    with pytest.raises(si.InputError, match="drift"):
        si.passages(lines(SPEEDS), "drfit", 1.0)
