"""Draws along a thin arc, to which no density can be fitted well: they are not called draws of another density."""

import numpy as np
import pytest

import structid as si
from structid.core.errors import InputError

END = 0.05
"""Standard deviation of the angle beyond the ends of an arc."""


def arc(dimension, width, reach, count=4000):
    """Draws whose first two parameters lie along an arc of radius 1, their target and its density."""

    def log_density(x):
        radius, angle = np.hypot(x[:, 0], x[:, 1]), np.abs(np.arctan2(x[:, 1], x[:, 0]))
        ends = np.maximum(angle - reach, 0.0) / END
        others = (x[:, 2:] ** 2).sum(axis=1) / 0.3**2
        return -0.5 * (((radius - 1.0) / width) ** 2 + ends**2 + others) - np.log(radius)

    rng = np.random.default_rng(0)
    inside = rng.random(count) < reach / (reach + END * np.sqrt(0.5 * np.pi))
    angle = np.where(inside, rng.uniform(0.0, reach, count), reach + np.abs(END * rng.normal(size=count)))
    angle *= rng.choice([-1.0, 1.0], count)
    radius = 1.0 + width * rng.normal(size=count)
    others = 0.3 * rng.normal(size=(count, dimension - 2))
    draws = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), others])
    names = tuple(f"x{i}" for i in range(dimension))
    space = si.ParameterSpace(**{name: si.Uniform(-3.0, 3.0) for name in names})
    return si.LogDensity(log_density, names, space, dict.fromkeys(names, (-3.0, 3.0))), draws, log_density


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [2, 4])
@pytest.mark.parametrize(("width", "reach"), [(0.01, 1.5), (0.03, 2.8)])
def test_their_own_density_is_accepted(dimension, width, reach):
    target, draws, log_density = arc(dimension, width, reach)
    assert si.certify(target, draws, log_density, seed=1).certified
    by_values = si.certify(target, draws, log_density(draws), seed=1)
    assert by_values.certified or "cannot decide" in str(by_values)


@pytest.mark.slow
def test_another_density_is_refused():
    """Without 12 % of the arc, an arc twice as thick, and values in another order."""
    target, draws, log_density = arc(2, 0.03, 2.8)
    angle = np.arctan2(draws[:, 1], draws[:, 0])
    with pytest.raises(InputError, match="does not match the draws"):
        si.certify(target, draws[angle < np.quantile(angle, 0.88)], log_density, seed=1)
    # In means and standard deviations, the arcs are the same.
    with pytest.raises(InputError, match="does not match the draws"):
        si.certify(arc(2, 0.06, 2.8)[0], draws, arc(2, 0.06, 2.8)[2], seed=1)
    with pytest.raises(InputError, match="does not match the draws"):
        si.certify(target, draws, log_density(draws)[::-1], seed=1)
