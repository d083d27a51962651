"""Moves of walkers: each has the law that its factor belongs to, and moments are right with any mix of them."""

import numpy as np
import pytest
import scipy.signal
import scipy.special
import scipy.stats

import structid as si
from structid.inference import convergence as diagnostics
from structid.inference.sampling.moves import (
    DEGREES_OF_FREEDOM,
    LAYERS,
    EnsembleState,
    IndependenceProposal,
    differential_proposal,
    independent_proposal,
    stretch_proposal,
)
from structid.inference.target import LogDensity
from targets import COVARIANCE, MEAN, TARGETS, gaussian


def moment_errors(result, mean, sd):
    """Deviations of means and sds in units of their own Monte-Carlo error."""
    kept = result.kept
    z_mean, z_sd = [], []
    for i in range(kept.shape[-1]):
        x = kept[..., i]
        squares = (x - mean[i]) ** 2
        z_mean.append((x.mean() - mean[i]) / (x.std() / np.sqrt(diagnostics.effective_sample_size(x))))
        error = squares.std() / np.sqrt(diagnostics.effective_sample_size(squares))
        z_sd.append((squares.mean() - sd[i] ** 2) / error)
    return np.array(z_mean), np.array(z_sd)


@pytest.mark.parametrize(
    "de", [0.0, pytest.param(0.5, marks=pytest.mark.slow), 1.0], ids=["stretch", "mixed", "differential"]
)
@pytest.mark.parametrize("name", TARGETS)
def test_moments_within_their_monte_carlo_error(name, de):
    make, mean, sd = TARGETS[name]
    result = si.sample(make(), si.AIES(walkers=40, steps=4000, ensembles=4, differential_evolution=de), seed=11)
    z_mean, z_sd = moment_errors(result, mean, sd)
    print(name, de, "z of means", np.round(z_mean, 1), "z of variances", np.round(z_sd, 1))
    assert np.abs(z_mean).max() < 4.0
    assert np.abs(z_sd).max() < 4.0


def test_the_printed_move_would_fail(monkeypatch):
    """The source prints x_i + Z (x_j − x_i) [2.31] with the acceptance of the stretch move: its moments are wrong."""

    def printed(rng, moving, resting, a):
        ensembles, walkers, dimension = moving.shape
        z = ((a - 1.0) * rng.random((ensembles, walkers)) + 1.0) ** 2 / a
        anchor = np.take_along_axis(
            resting, rng.integers(resting.shape[1], size=(ensembles, walkers))[:, :, None], axis=1
        )
        return moving + z[:, :, None] * (anchor - moving), (dimension - 1.0) * np.log(z)

    monkeypatch.setattr("structid.inference.sampling.moves.stretch_proposal", printed)
    result = si.sample(gaussian(), si.AIES(walkers=40, steps=4000, ensembles=4), seed=11)
    z_mean, z_sd = moment_errors(result, MEAN, np.sqrt(np.diag(COVARIANCE)))
    assert max(np.abs(z_mean).max(), np.abs(z_sd).max()) > 8.0


def test_stretch_variable_has_its_law():
    """Z ~ g(z) ∝ 1/√z on [1/a, a]: F(z) = (√(za) − 1)/(a − 1)."""
    moving, resting = np.ones((1, 100_000, 3)), np.zeros((1, 2, 3))
    proposal, log_factor = stretch_proposal(np.random.default_rng(0), moving, resting, 2.0)
    z = proposal[0, :, 0]
    assert scipy.stats.kstest(z, lambda v: np.sqrt(2 * v) - 1).pvalue > 1e-3
    np.testing.assert_allclose(log_factor[0], 2 * np.log(z), rtol=1e-12)


def test_affine_invariance():
    """The same seed on a stretched and shifted target gives the same chain, stretched and shifted."""
    scale, shift = np.array([1e6, 1e-3]), np.array([5.0, -7.0])
    plain = LogDensity(lambda x: -0.5 * (x**2).sum(1), "ab", lambda n, rng: rng.standard_normal((n, 2)))
    moved = LogDensity(
        lambda x: -0.5 * (((x - shift) / scale) ** 2).sum(1),
        "ab",
        lambda n, rng: shift + scale * rng.standard_normal((n, 2)),
    )
    settings = si.AIES(walkers=10, steps=60, ensembles=2, differential_evolution=0.3)
    first, second = (si.sample(t, settings, seed=3).history for t in (plain, moved))
    np.testing.assert_allclose(second, shift + scale * first, rtol=1e-6, atol=1e-6 * scale.min())


def test_differential_moves_never_use_the_same_walker_twice():
    resting = np.eye(4)[None] * 5.0
    proposal, _ = differential_proposal(np.random.default_rng(0), np.zeros((1, 5000, 4)), resting)
    assert (np.abs(proposal[0]).sum(axis=1) > 0).all()


def independent_moves(monkeypatch, factor):
    """Let an ensemble make them in half of its steps, with their factor times another."""

    def propose(moves, rng, _kind, moving, resting):
        if rng.random() < 0.5:
            return stretch_proposal(rng, moving, resting.phi, moves.stretch)
        proposal, log_factor = independent_proposal(rng, moving, IndependenceProposal.fitted(resting))
        return proposal, factor * log_factor

    monkeypatch.setattr("structid.inference.sampling.moves.Moves.propose", propose)


@pytest.mark.parametrize("name", [n if n == "skewed" else pytest.param(n, marks=pytest.mark.slow) for n in TARGETS])
def test_moments_with_independence_moves(name, monkeypatch):
    make, mean, sd = TARGETS[name]
    independent_moves(monkeypatch, 1.0)
    result = si.sample(make(), si.AIES(walkers=40, steps=4000, ensembles=4), seed=11)
    z_mean, z_sd = moment_errors(result, mean, sd)
    assert np.abs(z_mean).max() < 4.0
    assert np.abs(z_sd).max() < 4.0


def test_independence_moves_without_their_factor_would_fail(monkeypatch):
    independent_moves(monkeypatch, 0.0)
    make, mean, sd = TARGETS["skewed"]
    z_mean, z_sd = moment_errors(si.sample(make(), si.AIES(walkers=40, steps=4000, ensembles=4), seed=11), mean, sd)
    assert max(np.abs(z_mean).max(), np.abs(z_sd).max()) > 8.0


def test_independence_moves_have_the_law_of_their_factor():
    """A mixture of Student laws of the densest walkers: factor and draws against scipy's."""
    rng = np.random.default_rng(0)
    resting = rng.standard_normal((2, 100, 3)) @ np.array([[1.0, 0.0, 0.0], [0.9, 0.1, 0.0], [0.0, 3.0, 1.0]])
    density = -((resting - 1.0) ** 2).sum(axis=2)
    moving = rng.standard_normal((2, 20_000, 3))
    proposal, log_factor = independent_proposal(
        rng, moving, IndependenceProposal.fitted(EnsembleState(resting, density))
    )
    for k in range(2):
        laws, shares = [], []
        for densest, share in LAYERS:
            part = resting[k, np.argsort(-density[k])[: round(100 * densest)]]
            laws.append(scipy.stats.multivariate_t(part.mean(0), np.cov(part.T, bias=True), df=DEGREES_OF_FREEDOM))
            shares.append(share)

        def log_law(x, laws=laws, shares=shares):
            return scipy.special.logsumexp([law.logpdf(x) for law in laws], axis=0, b=np.array(shares)[:, None])

        np.testing.assert_allclose(log_factor[k], log_law(moving[k]) - log_law(proposal[k]), atol=1e-3)
        for i in range(3):

            def cdf(x, i=i, laws=laws, shares=shares):
                each = [scipy.stats.t.cdf(x, DEGREES_OF_FREEDOM, law.loc[i], np.sqrt(law.shape[i, i])) for law in laws]
                return np.average(each, axis=0, weights=shares)

            assert scipy.stats.kstest(proposal[k, :, i], cdf).pvalue > 1e-3


def test_independence_moves_of_walkers_in_a_plane():
    """All copies of one, and fewer than dimensions: nothing breaks, and nothing finite comes of nothing."""
    rng = np.random.default_rng(1)
    for resting in (np.ones((2, 10, 4)), rng.standard_normal((2, 3, 4))):
        law = IndependenceProposal.fitted(EnsembleState(resting, np.zeros(resting.shape[:2])))
        proposal, log_factor = independent_proposal(rng, rng.standard_normal((2, 10, 4)), law)
        assert np.isfinite(proposal).all() and np.isfinite(log_factor).all()
