"""Delayed acceptance: the model's own posterior whatever the surrogate, few model runs, the same after a kill."""

from dataclasses import replace

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError, StoreMismatchError
from structid.core.streams import stream
from structid.inference.sampling.moves import Moves

PRECISION = np.linalg.inv([[1.0, 0.8, 0.0], [0.8, 1.0, 0.3], [0.0, 0.3, 1.0]])
SPACE = si.ParameterSpace(a=si.Normal(0.0, 5.0), b=si.Normal(0.0, 5.0), c=si.Normal(0.0, 5.0))
SETTINGS = si.DelayedAcceptance(steps=60, discard=0.2, tuning=10, most_sub_steps=64)


def gaussian(shift=0.0, scale=1.0):
    def density(theta):
        gap = (theta - shift) / scale
        return -0.5 * np.einsum("ni,ij,nj->n", gap, PRECISION, gap)

    return si.LogDensity(density, SPACE.names, SPACE)


class Counted(si.LogDensity):
    """Counts what it is asked, and can be made to stop."""

    def __init__(self, limit=np.inf):
        plain = gaussian()
        super().__init__(plain._function, SPACE.names, SPACE)
        self.asked, self.limit = 0, limit

    def evaluate(self, phi):
        if self.asked + len(phi) > self.limit:
            raise KeyboardInterrupt
        self.asked += len(phi)
        return super().evaluate(phi)


@pytest.mark.parametrize(
    ("shift", "scale"), [(0.0, 1.0), (0.6, 1.0), pytest.param(0.0, 1.4, marks=pytest.mark.slow), (0.0, 0.8)]
)
def test_the_draws_are_the_model_s_whatever_the_surrogate(shift, scale):
    settings = SETTINGS if (shift, scale) == (0.0, 1.0) else replace(SETTINGS, steps=300)
    result = si.sample(gaussian(), replace(settings, approximation=gaussian(shift, scale)), seed=1)
    error = 1.0 / np.sqrt(result.summary().columns["ess_bulk"])
    assert (np.abs(result.mean) < 4.0 * error).all(), (result.mean, error)
    assert (np.abs(result.sd - 1.0) < 4.0 * error).all(), (result.sd, error)
    # What a chain under the surrogate alone would have found fails the same test, so the test can fail.
    if shift:
        assert (np.abs(shift) > 4.0 * error).all()
    elif scale != 1.0:
        assert (np.abs(scale - 1.0) > 4.0 * error).all()


def test_a_perfect_surrogate_makes_every_true_run_a_draw():
    target = Counted()
    local = dict(independent=0.0, sub_steps=1)
    result = si.sample(target, replace(SETTINGS, approximation=gaussian(), steps=200, **local), seed=2)
    assert result.cost.true_runs == target.asked
    assert result.cost.acceptance == 1.0 and result.cost.sub_steps >= 8
    assert result.cost.speed_up > 5.0
    assert result.summary().columns["ess_bulk"].min() > 0.5 * len(result.flat)
    assert "moves per model run" in str(result.cost)


def test_a_density_with_other_bounds_proposes_in_the_coordinates_of_the_target():
    """It would be of other θ at the same φ, and nearly all that it proposes would be refused."""
    bounded = si.LogDensity(gaussian()._function, SPACE.names, SPACE, dict.fromkeys(SPACE.names, (-4.0, 9.0)))
    result = si.sample(bounded, replace(SETTINGS, approximation=gaussian()), seed=2)
    assert result.cost.acceptance > 0.99


def test_the_law_of_independence_moves_is_learnt_while_tuning_and_then_stays():
    """A law that went on learning from the chain that it moves would make that no Markov chain."""
    blocks = []
    settings = replace(SETTINGS, approximation=gaussian(), steps=30, discard=0.5)
    settings.run(gaussian(), 7, None, [], lambda _index, block: blocks.append(block))
    learnt, last, early = (settings._learnt_proposal(blocks[:count]) for count in (settings.tuning, 30, 3))
    np.testing.assert_array_equal(learnt.middle, last.middle)
    np.testing.assert_array_equal(learnt.factor, last.factor)
    assert not np.allclose(learnt.middle, early.middle)
    # Of 5 steps of 128 walkers: the posterior's own covariance in its widest layer, which a half of 16 walkers does not give.
    covariance = learnt.factor[0, 0] @ learnt.factor[0, 0].T
    np.testing.assert_allclose(covariance, np.linalg.inv(PRECISION), atol=0.25)


def test_a_learnt_law_needs_shorter_sub_chains():
    """Independence moves forget where they came from; local ones need a longer sub-chain for the same."""
    lengths = [
        si.sample(gaussian(), replace(SETTINGS, approximation=gaussian(), sub_steps=1, independent=share), seed=2).cost
        for share in (0.0, 0.5)
    ]
    assert lengths[1].sub_steps < lengths[0].sub_steps


def test_sub_chains_that_go_nowhere_are_lengthened():
    """Stretches so wide that hardly one in a sub-chain of one is taken: the model refuses none of what it is shown."""
    wide = dict(stretch=1e6, independent=0.0, differential_evolution=0.0)
    result = si.sample(gaussian(), replace(SETTINGS, approximation=gaussian(), sub_steps=1, **wide), seed=6)
    assert result.cost.sub_steps >= 32


def test_sub_chains_are_shortened_where_proposals_are_refused():
    settings = replace(SETTINGS, approximation=gaussian(2.5, 0.5), sub_steps=64, discard=0.5, tuning=30)
    bad = si.sample(gaussian(), settings, seed=3)
    assert bad.cost.sub_steps <= 16


@pytest.mark.parametrize("length", range(1, 7))
def test_a_sub_chain_is_as_reversible_as_each_of_its_moves(length):
    """P_a P_b of two moves with detailed balance has none: what would be accepted with π(x′) π_s(x) / [π(x) π_s(x′)] is off."""
    rng, probability = np.random.default_rng(length), np.array([0.5, 0.3, 0.2])

    def metropolis(proposal):
        kernel = proposal * np.minimum(1.0, probability[None, :] * proposal.T / (probability[:, None] * proposal))
        return kernel + np.diag(1.0 - kernel.sum(axis=1))

    kernels = {
        kind: metropolis(rng.dirichlet(np.ones(3), size=3))
        for kind in ("independent", "differential evolution", "stretch")
    }
    moves = Moves(2.0, differential_evolution=0.5, independent=0.3)

    def lack_of_balance(kinds):
        flow = probability[:, None] * np.linalg.multi_dot([np.eye(3), np.eye(3), *(kernels[kind] for kind in kinds)])
        return np.abs(flow - flow.T).max()

    for _ in range(20):
        kinds = moves.there_and_back(rng, length)
        assert len(kinds) == length and lack_of_balance(kinds) < 1e-15
    assert lack_of_balance(["stretch", "independent"]) > 1e-3


@pytest.mark.slow
def test_walkers_where_the_surrogate_has_no_density():
    """A surrogate with a hole: walkers reach it by plain steps, and leave it so."""

    def holed(theta):
        return np.where(theta[:, 0] < -0.5, -np.inf, gaussian()._function(theta))

    surrogate = si.LogDensity(holed, SPACE.names, SPACE)
    result = si.sample(gaussian(), replace(SETTINGS, approximation=surrogate, steps=500, most_sub_steps=16), seed=8)
    error = 1.0 / np.sqrt(result.summary().columns["ess_bulk"])
    assert (result.kept[..., 0] < -0.5).mean() > 0.2
    assert (np.abs(result.mean) < 4.0 * error).all(), (result.mean, error)


def test_a_frozen_half_leaves_the_posterior_as_it_is():
    """One step from exact draws gives exact draws: second moments of many independent ensembles, within 4 sd."""
    settings = si.DelayedAcceptance(gaussian(0.5, 0.8), walkers=6, ensembles=2000, sub_steps=4, tuning=0, steps=2)
    target, rng = gaussian(), stream(1, 99, 0)
    root = np.linalg.cholesky(np.linalg.inv(PRECISION))
    exact = rng.normal(size=(12_000, 3)) @ root.T
    result = si.sample(target, settings, seed=5, start=exact)
    last = result.history[-1].reshape(-1, 3)
    assert result.accepted[-1].mean() > 0.1
    # Walkers of an ensemble share its resting half, so the error is that of the ensembles' means.
    squares = ((last @ np.linalg.inv(root).T) ** 2).reshape(2000, -1).mean(axis=1)
    assert abs(squares.mean() - 1.0) < 4.0 * squares.std() / np.sqrt(2000)


def test_a_killed_chain_goes_on_to_the_same_bits(tmp_path):
    settings = replace(SETTINGS, approximation=gaussian(0.3), steps=20, discard=0.5)
    whole = si.sample(Counted(), settings, seed=4)
    with pytest.raises(KeyboardInterrupt):
        si.sample(Counted(limit=1000), settings, seed=4, store=tmp_path / "chains.h5")
    target = Counted()
    resumed = si.sample(target, settings, seed=4, store=tmp_path / "chains.h5")
    np.testing.assert_array_equal(resumed.history, whole.history)
    assert resumed.cost == whole.cost and target.asked < whole.cost.true_runs
    # Gone on from after the tuning, too: what was learnt there is learnt again from what is on disk.
    longer = si.sample(Counted(), replace(settings, steps=30), seed=4, store=tmp_path / "chains.h5")
    np.testing.assert_array_equal(longer.history[:20], whole.history)
    np.testing.assert_array_equal(longer.history, si.sample(Counted(), replace(settings, steps=30), seed=4).history)
    with pytest.raises(StoreMismatchError):
        other = replace(settings, approximation=Counted(), sub_steps=8)
        si.sample(Counted(), other, seed=4, store=tmp_path / "chains.h5")


@pytest.mark.slow
def test_a_posterior_and_its_surrogate(short_posterior):
    """A surrogate past its limit for standing in a posterior: the draws are the model's all the same."""
    model, record = short_posterior.model, short_posterior.observations[0].record
    runs = si.Campaign(model, record, short_posterior.model_space.sample(150, seed=1, widen=2.0)).run()
    surrogate = replace(si.PODKriging(), limit=1e-12).fit(runs)
    with pytest.raises(InputError, match="in a posterior"):
        short_posterior.on(surrogate)
    settings = si.DelayedAcceptance(surrogate, steps=45, tuning=15)
    result = si.sample(short_posterior, settings, seed=1)
    reference = si.sample(short_posterior, si.SMC(particles=400, steps=40), seed=2)
    size = np.minimum(result.summary().columns["ess_bulk"], reference.summary().columns["ess_bulk"])
    assert (np.abs(result.mean - reference.mean) < 5.0 * reference.sd / np.sqrt(size)).all(), str(result.summary())
    assert result.cost.true_runs < 8000


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(walkers=7), "walkers.*even"),
        (dict(tuning=50), "tuning.*at most 12, the number of discarded steps"),
        (dict(discard=1.0), "discard.*fraction"),
        (dict(stretch=0.5), "stretch.*above 1"),
        (dict(sub_steps=0), "sub_steps.*1 or more"),
    ],
)
def test_settings_that_make_no_sense(change, words):
    with pytest.raises(InputError, match=words):
        replace(SETTINGS, **change)


@pytest.mark.parametrize(
    ("approximation", "words"),
    [(None, "no approximation"), (si.LogDensity(lambda t: -(t[:, 0] ** 2), ("x",), np.zeros((9, 1))), "LogDensity")],
)
def test_an_approximation_of_something_else_is_refused(approximation, words):
    with pytest.raises(InputError, match=words):
        si.sample(gaussian(), replace(SETTINGS, approximation=approximation), seed=1)
