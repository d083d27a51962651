"""The evidence from proposals: right where they cover the particles, and none where they do not."""

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.inference.sampling.smc.proposal_weights import (
    NOTHING,
    UPPER,
    evidence_of_proposals,
    sums_of_weights,
    together,
)

NORMAL = scipy.stats.norm(0.0, 1.0)


def sums(steps, draw, log_proposal, log_target, particles, seed=0):
    """Sums of two populations over some moves of 500 proposals."""
    rng, each = np.random.default_rng(seed), []
    for _ in range(steps):
        x = draw(rng, (2, 500))
        each.append(
            sums_of_weights(log_target(x) - log_proposal(x), log_target(x), log_target(particles(rng, (2, 4000))))
        )
    return np.stack(each)


def test_sums_add_up():
    rng = np.random.default_rng(1)
    log_weight, log_density = rng.normal(size=(2, 300)), rng.normal(size=(2, 300))
    particles = rng.normal(size=(2, 1000))
    whole = sums_of_weights(log_weight, log_density, particles)
    parts = [sums_of_weights(log_weight[:, k::3], log_density[:, k::3], particles) for k in range(3)]
    np.testing.assert_allclose(together(np.stack([*parts, np.tile(NOTHING, (2, 1))])), whole, rtol=1e-12)
    np.testing.assert_allclose(whole[:, 1], np.log(np.exp(log_weight).sum(axis=1)))
    levels = np.quantile(particles, [1.0 - fraction for fraction in UPPER], axis=1)
    expected = [np.log(np.exp(log_weight[0][log_density[0] > level]).sum()) for level in levels[:, 0]]
    np.testing.assert_allclose(whole[0, 4:], expected)


def test_the_error_is_that_of_repeated_samples():
    """A normal density of mass e³ by Student proposals: errors of 40 samples against those stated."""
    wider = scipy.stats.t(10.0, 0.2, 1.2)
    found = [
        evidence_of_proposals(
            sums(
                20,
                lambda rng, shape: wider.rvs(size=shape, random_state=rng),
                wider.logpdf,
                lambda x: NORMAL.logpdf(x) + 3.0,
                lambda rng, shape: rng.normal(size=shape),
                seed,
            )
        )
        for seed in range(40)
    ]
    errors = np.array([evidence.value - 3.0 for evidence in found])
    stated = np.array([evidence.error for evidence in found])
    assert abs(errors.mean()) < 4.0 * errors.std() / np.sqrt(40.0) + 1e-4
    assert errors.std() < stated.mean() < 4.0 * errors.std()  # the gap of the shares is a part of the error


def test_proposals_that_miss_a_mode_give_no_evidence():
    """A fifth of the mass at 30 sd: the weights of the others are even, but the densest half of the particles is not theirs."""

    def log_target(x):
        return np.logaddexp(np.log(0.8) + NORMAL.logpdf(x), np.log(0.2) + scipy.stats.norm.logpdf(x, 30.0, 0.01))

    def particles(rng, shape):
        return np.where(rng.random(shape) < 0.2, 30.0 + 0.01 * rng.normal(size=shape), rng.normal(size=shape))

    def draw(rng, shape):
        return 1.2 * rng.normal(size=shape)

    log_proposal = scipy.stats.norm(0.0, 1.2).logpdf
    assert evidence_of_proposals(sums(20, draw, log_proposal, log_target, particles)) is None
    alone = sums(20, draw, log_proposal, NORMAL.logpdf, lambda rng, shape: rng.normal(size=shape))
    assert evidence_of_proposals(alone) is not None
    assert evidence_of_proposals(alone[:1, :, :]) is None  # too few
    assert evidence_of_proposals(np.tile(NOTHING, (5, 2, 1))) is None


@pytest.mark.parametrize("seed", [0, 3, 5])
def test_a_narrow_mode_that_rises_late_does_not_bias_the_evidence(seed):
    """90 % of the mass in a hundredth of the width: the tempering steps alone were wrong by 0.1 to 1 nat."""
    centre = np.array([0.5, -0.4])

    def density(x):
        wide = np.log(0.1) + NORMAL.logpdf(x).sum(axis=1)
        return np.logaddexp(wide, np.log(0.9) + scipy.stats.norm.logpdf(x, centre, 0.01).sum(axis=1))

    space = si.ParameterSpace(x=si.Uniform(-5.0, 5.0), y=si.Uniform(-5.0, 5.0))
    target = si.LogDensity(density, ("x", "y"), space, {"x": (-5.0, 5.0), "y": (-5.0, 5.0)})
    result = si.sample(target, si.SMC(), seed=seed)
    if result.verdict().converged:
        assert abs(result.log_evidence.value) < 4.0 * result.log_evidence.error < 0.2
