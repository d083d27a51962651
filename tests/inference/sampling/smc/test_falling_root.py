"""Roots that tempering and the evidence need, of log densities as models that diverge give them."""

import numpy as np
import pytest

from structid.inference.sampling.smc.bridge_sampling import bennett_ratio
from structid.inference.sampling.smc.falling_root import root_of_falling
from structid.inference.sampling.smc.tempering import next_exponent

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("root", [0.3, -7.0, 1e12, -1e200])
def test_a_root_is_found_from_afar(root):
    calls = []

    def falling(x):
        calls.append(x)
        return root - x

    assert root_of_falling(falling, 0.0, 1e-10) == pytest.approx(root, rel=1e-14, abs=1e-10)
    assert len(calls) < 800


def test_a_function_without_a_root_ends():
    for value in (1.0, -1.0, np.nan):
        assert not np.isfinite(value) or abs(root_of_falling(lambda _, v=value: v, 0.0, 1e-10)) > 1e300


def shares(likelihood, exponent):
    weights = np.exp(exponent * (likelihood - likelihood.max(axis=1, keepdims=True)))
    return weights.sum(axis=1) ** 2 / (weights**2).sum(axis=1) / likelihood.shape[1]


def test_the_next_exponent_leaves_its_share():
    likelihood = -10.0 * RNG.random((2, 50))
    assert shares(likelihood, next_exponent(likelihood, 0.0, 0.7)).mean() == pytest.approx(0.7, abs=1e-5)
    assert next_exponent(likelihood, 0.999, 0.7) == 1.0


def test_a_population_without_a_usable_particle_does_not_stop_the_others():
    likelihood = -10.0 * RNG.random((2, 50))
    alone = next_exponent(likelihood[:1], 0.0, 0.7)
    likelihood[1] = -np.inf
    assert next_exponent(likelihood, 0.0, 0.7) == pytest.approx(alone, rel=1e-9)


def test_log_densities_over_the_whole_range_of_numbers():
    """One draw of five hundred counts: the root lies 1e300 from the median, where a bracket of that width has no end."""
    likelihood = -(10.0 ** RNG.uniform(0.0, 308.0, (2, 200)))
    assert 0.0 < next_exponent(likelihood, 0.0, 0.7) < 1e-200
    draws = RNG.normal(size=500)
    found, _ = bennett_ratio(draws, np.r_[np.full(499, -1e300), 0.0])
    assert -10.0 < found < 0.0
    equal, error = bennett_ratio(draws, draws)
    assert abs(equal) < 5.0 * np.sqrt(error)
