"""Designs: inside, seeded, uniform, and better than chance where they promise it."""

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from structid.probability.designs import METHODS, smallest_distance, unit_design


@pytest.mark.parametrize("method", METHODS)
def test_designs_are_inside_seeded_and_uniform(method):
    points = unit_design(256, 3, seed=5, method=method)
    assert points.shape == (256, 3)
    assert (points > 0).all() and (points < 1).all()
    np.testing.assert_array_equal(points, unit_design(256, 3, seed=5, method=method))
    assert not np.array_equal(points, unit_design(256, 3, seed=6, method=method))
    assert all(scipy.stats.kstest(column, "uniform").pvalue > 1e-4 for column in points.T)


def test_latin_hypercubes_have_one_point_a_row():
    for method in ("latin_hypercube", "maximin"):
        points = unit_design(100, 4, seed=1, method=method)
        assert (np.sort(np.floor(points * 100), axis=0) == np.arange(100)[:, None]).all()


def test_maximin_spreads_the_points():
    plain = np.mean([smallest_distance(unit_design(60, 3, s, "latin_hypercube")) for s in range(5)])
    spread = np.mean([smallest_distance(unit_design(60, 3, s, "maximin")) for s in range(5)])
    assert spread > 1.5 * plain


def test_sobol_integrates_better_than_chance():
    def error(method):
        values = [np.prod(1 + 0.5 * (unit_design(512, 4, s, method) - 0.5), axis=1).mean() - 1 for s in range(10)]
        return np.sqrt(np.mean(np.square(values)))

    assert error("sobol") < 0.1 * error("random")
