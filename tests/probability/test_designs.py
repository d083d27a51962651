"""Designs: inside, seeded, uniform, and better than chance where they promise it."""

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

import structid as si
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


def test_samples_of_a_prior_are_drawn_with_its_density():
    """Every density that is drawn has the mass of what it shows, in display units."""
    space = si.ParameterSpace(stiffness=si.Normal(7.42, 0.742, unit="kN/mm"), alpha=si.LogNormal(0.063, 0.01, high=1.0))
    figure = space.sample(400, seed=1).plot()
    diagonal = [figure.axes[0], figure.axes[3]]
    for axis in diagonal:
        x, y = axis.lines[0].get_data()
        assert np.trapezoid(y, x) == pytest.approx(1.0, abs=0.01)
    assert diagonal[0].get_xlim()[1] < 20.0
    with pytest.raises(si.InputError, match="1 points of 2 parameters"):
        space.sample(1, seed=1).plot()
