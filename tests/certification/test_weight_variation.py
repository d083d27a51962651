"""How much weights vary: nothing is known from one draw that counts for all of them."""

import numpy as np
import pytest

from structid.certification.weight_variation import weight_variation


def test_equal_weights_of_many_draws_do_not_vary():
    found = weight_variation(np.zeros(30), np.ones(30), 0.95)
    assert max(found.estimate, found.bound) < 1e-12


@pytest.mark.parametrize("log_ratio", [0.0, 3.0])
@pytest.mark.parametrize("others", [0.0, 1e-30, 1e-12])
def test_one_draw_that_counts_for_all_says_nothing(log_ratio, others):
    shares = np.full(30, others)
    shares[7] = 1.0
    log_ratios = np.linspace(0.0, 1.0, 30)
    log_ratios[7] = log_ratio
    assert weight_variation(log_ratios, shares, 0.95).bound == np.inf
