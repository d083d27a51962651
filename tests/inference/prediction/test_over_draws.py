"""Quantiles over draws, sample by sample: in blocks they are those of NumPy, which takes all at once."""

import numpy as np
import pytest

from structid.inference.prediction import over_draws

DRAWS = np.random.default_rng(0).normal(size=(7, 50, 2))


@pytest.mark.parametrize("size", [1, 14, 200, 10**6])
def test_blocks_of_any_size_give_the_same(monkeypatch, size):
    monkeypatch.setattr(over_draws, "VALUES_AT_ONCE", size)
    np.testing.assert_array_equal(over_draws.median(DRAWS), np.median(DRAWS, axis=0))
    np.testing.assert_array_equal(
        over_draws.quantiles(DRAWS, [0.05, 0.5, 0.9]), np.quantile(DRAWS, [0.05, 0.5, 0.9], axis=0)
    )
