"""Two explorers of one density: they agree where the draws are right, and a second one finds what a first has missed."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

import structid as si
from structid.inference.diagnostics.second_sampler import check_representation

normal = scipy.stats.norm.logpdf
SAMPLER = si.SMC(particles=400, steps=40, effective_share=0.5, correlation=0.3)
BOX = (-10.0, 10.0)


def compared(drawn, known, seed):
    return check_representation(drawn.target, drawn.kept, known, seed, evidence=drawn.log_evidence)


def boxed(density, dimension):
    names = tuple(f"x{i}" for i in range(dimension))
    space = si.ParameterSpace(**{n: si.Uniform(*BOX) for n in names})
    return si.LogDensity(density, names, space, dict.fromkeys(names, BOX))


def two_modes(dimension, widths=(0.1, 0.3), narrow=0.5):
    """A narrow mode and a wide one; they integrate to one."""

    def density(x):
        parts = [normal(x, at, width).sum(axis=1) for at, width in zip((3.0, -3.0), widths, strict=True)]
        return np.logaddexp(np.log(narrow) + parts[0], np.log1p(-narrow) + parts[1])

    return boxed(density, dimension)


NOTHING_KNOWN = np.empty((0, 4))


@pytest.mark.parametrize("seed", range(5))
def test_good_draws_of_one_mode_raise_no_alarm(seed):
    drawn = si.sample(boxed(lambda x: normal(x, 1.0, 0.3).sum(axis=1), 4), SAMPLER, seed=seed)
    found = compared(drawn, NOTHING_KNOWN, seed)
    assert found.agreed and len(found.modes) == 1, str(found)
    assert "finds one mode" in str(found) and np.abs(found.mean_gap).max() < 0.1
    np.testing.assert_allclose(found.modes[0], 1.0, atol=0.01)  # in logits the maximum lies a little elsewhere


@pytest.mark.parametrize("dimension", [2, 6])
def test_modes_of_two_widths(dimension):
    """Found from the prior alone, in a box of which the narrow mode is a part in 10⁶; the first explorer may lose it."""
    drawn = si.sample(two_modes(dimension), SAMPLER, seed=1)
    found = compared(drawn, np.empty((0, dimension)), 1)
    assert len(found.modes) == 2 and found.agreed == ((drawn.flat[:, 0] > 0.0).mean() > 0.4), str(found)
    np.testing.assert_allclose(found.shares_again, 0.5, atol=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_narrow_heavy_mode_at_a_known_point(seed):
    """Particles from the prior have lost it; a model run lies in it."""
    drawn = si.sample(two_modes(6), replace(SAMPLER, scouts=0), seed=seed)
    assert drawn.flat[:, 0].max() < 0.0 and drawn.verdict().converged
    found = compared(drawn, np.full((1, 6), 3.05), seed)
    assert not found.agreed and len(found.modes) == 2
    np.testing.assert_allclose(np.sort(found.shares), [0.0, 1.0])
    np.testing.assert_allclose(found.shares_again, 0.5, atol=0.06)
    assert found.evidence_gap == pytest.approx(np.log(2.0), abs=0.2)
    assert "lie at mode" in str(found)


def test_draws_with_the_wrong_shares_of_modes_that_they_know():
    """Both modes have draws, one of them too few."""
    drawn = si.sample(two_modes(3), SAMPLER, seed=3)
    # Of every third draw in the upper mode a draw in the lower one takes the place.
    rng, flat = np.random.default_rng(1), drawn.history.reshape(-1, 3).copy()
    lower = flat[:, 0] < 0.0
    swap = ~lower & (rng.uniform(size=len(flat)) < 1 / 3)
    flat[swap] = rng.choice(flat[lower], size=swap.sum())
    wrong = replace(drawn, history=flat.reshape(drawn.history.shape))
    assert compared(drawn, np.empty((0, 3)), 3).agreed
    found = compared(wrong, np.empty((0, 3)), 3)
    assert not found.agreed and found.shares.min() < 0.4 < found.shares_again.min(), str(found)


def test_draws_that_are_too_narrow():
    drawn = si.sample(boxed(lambda x: normal(x, 1.0, 0.3).sum(axis=1), 3), SAMPLER, seed=2)
    narrow = replace(drawn, history=1.0 + 0.8 * (drawn.history - 1.0))
    found = compared(narrow, np.empty((0, 3)), 2)
    assert any("times the standard deviation" in said for said in found.failures)
    shifted = replace(drawn, history=drawn.history + np.array([0.06, 0.0, 0.0]))
    assert any("shifts the mean of x0 by -0.2" in said for said in compared(shifted, np.empty((0, 3)), 2).failures)


def test_chains_are_compared_too():
    """A sampler that knows no evidence."""
    chains = si.AIES(walkers=32, steps=1500, ensembles=4)
    drawn = si.sample(boxed(lambda x: normal(x, 1.0, 0.3).sum(axis=1), 3), chains, seed=2)
    found = compared(drawn, np.empty((0, 3)), 2)
    assert found.agreed and np.isnan(found.evidence_gap)
