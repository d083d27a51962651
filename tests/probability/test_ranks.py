"""Ranks, beside those of SciPy."""

import numpy as np
import pytest
import scipy

from structid.probability.ranks import ranks


@pytest.mark.parametrize("shape", [(1,), (40,), (7, 3, 20)])
@pytest.mark.parametrize("kinds", [1, 5, 10_000])
def test_equal_numbers_share_the_mean_of_their_places(shape: tuple[int, ...], kinds: int) -> None:
    values = np.random.default_rng(len(shape)).integers(kinds, size=shape) / 7.0
    found = ranks(values)
    assert found.shape == shape
    assert np.array_equal(found.ravel(), scipy.stats.rankdata(values))


def test_infinite_numbers_have_ranks() -> None:
    assert ranks(np.array([-np.inf, 0.0, np.inf, -np.inf])).tolist() == [1.5, 3.0, 4.0, 1.5]
