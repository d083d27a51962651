"""A certificate's draws judge the surrogate that they have trained: only surrogates that have not seen them may say so."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats

from structid.calibration.cross_validation import cross_validate
from structid.calibration.next_runs import Batch
from structid.certification.certificate import issue_certificate
from structid.certification.fresh_draws import THEMSELVES, FreshDraws, StoredRuns

DIMENSION = 4


def log_true(theta):
    return scipy.stats.norm.logpdf(theta).sum(axis=1)


class Interpolating:
    """A surrogate that is right at its runs, and off by a smooth error elsewhere."""

    def __init__(self, error, runs):
        self.error, self.runs = error, runs

    def compared(self, theta):
        return theta

    def log_density(self, theta):
        distance = np.linalg.norm(theta[:, None] - self.runs[None], axis=2).min(axis=1)
        return log_true(theta) + self.error * np.tanh(50.0 * distance) * np.sin(3.0 * theta).sum(axis=1) + 7.0


def one_look(error, seed, count=30):
    rng = np.random.default_rng(seed)
    many, fresh = rng.standard_normal((4000, DIMENSION)), rng.standard_normal((count, DIMENSION))
    known = 3.0 * rng.standard_normal((70, DIMENSION))
    old = Interpolating(0.3, known)
    drawn = SimpleNamespace(thinned=lambda n: many[:n], log_density=log_true(many), discarded=0)
    nothing = np.empty((0, DIMENSION))
    batch = Batch(fresh, old.log_density(fresh), np.ones(count), nothing, many, 0.0)
    of_all = Interpolating(error, np.concatenate([known, fresh]))

    def without(places):
        return Interpolating(error, np.concatenate([known, np.delete(fresh, places, axis=0)]))

    return batch, cross_validate(batch, drawn, of_all, without), of_all


def verdict(batch, log_drawn, beside=THEMSELVES, shares=None):
    shares = batch.shares if shares is None else shares
    fresh = FreshDraws(
        batch.fresh,
        batch.fresh,
        log_true(batch.fresh),
        log_drawn,
        shares,
        batch.population,
        batch.highest,
        None,
        beside,
    )
    return issue_certificate(fresh, StoredRuns(), tuple("abcd"), 100, 2)


@pytest.mark.parametrize("seed", range(10))
def test_an_interpolation_that_is_wrong_between_its_runs_is_refused(seed):
    """It says of its own runs that it is right; those which are left out say that it is not."""
    batch, (again, beside), of_all = one_look(0.15, seed)
    assert verdict(batch, of_all.log_density(batch.fresh)).certified
    assert not verdict(again, again.log_surrogate, beside, again.shares).certified


@pytest.mark.parametrize("seed", range(10))
def test_a_surrogate_that_has_become_good_passes(seed):
    """What was 0.3 nats off is 0.01 off now: shares turn averages over the old surrogate's posterior into the new one's."""
    batch, (again, beside), _ = one_look(0.01, seed)
    assert not verdict(batch, batch.log_surrogate).certified
    found = verdict(again, again.log_surrogate, beside, again.shares)
    assert found.certified and found.variation.bound > beside.variation > 0.0, str(found)
    assert np.all(found.mean_bound < found.variation.bound)  # the moments of what was left out are known


def test_scales_of_the_surrogates_do_not_matter():
    """A surrogate knows its density up to a factor only, and each that leaves draws out has another one."""
    batch, _, _ = one_look(0.01, 1)
    many = np.random.default_rng(1).standard_normal((4000, DIMENSION))
    drawn = SimpleNamespace(thinned=lambda n: many[:n], log_density=log_true(many), discarded=0)
    exact = SimpleNamespace(log_density=log_true, compared=lambda theta: theta)

    def without(places):
        return SimpleNamespace(log_density=lambda theta: log_true(theta) + 10.0 * places[0])

    judged_again, beside = cross_validate(batch, drawn, exact, without)
    np.testing.assert_allclose(judged_again.log_surrogate, log_true(batch.fresh), atol=1e-12)
    assert beside.variation < 1e-12 and np.all(beside.mean < 1e-12)
    ratio = judged_again.shares / np.exp(log_true(batch.fresh) - batch.log_surrogate)
    np.testing.assert_allclose(ratio, ratio[0])
