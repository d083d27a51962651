"""Exponential, logarithm and what else lanes compute themselves, against extended precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from structid.engine.lanes.in_lanes import InLanes

pytestmark = pytest.mark.quick

RNG = np.random.default_rng(0)
ROUNDING = 4e-16
"""Relative error that is allowed: less than two units in the last place."""


def in_lanes(function):
    """A function of one number a run, inside a loop of one pass."""

    def looped(theta):
        return jax.lax.scan(lambda x, _: (function(x), None), theta[:, 0], np.zeros((1, 1)))[0]

    compiled = InLanes(looped)

    def call(x):
        found = compiled(np.asarray(x, dtype=float)[:, None])
        assert not compiled.why_not
        return found

    return call


NEAR_ONE = 1.0 + 1e-3 * RNG.normal(size=20_000)
CASES = {
    "exp": (
        jnp.exp,
        np.exp,
        np.concatenate([RNG.uniform(-707.0, 709.7, 50_000), RNG.normal(size=50_000), [0.0, 1e-320]]),
    ),
    "log": (jnp.log, np.log, np.concatenate([np.exp(RNG.uniform(-700.0, 700.0, 50_000)), NEAR_ONE, [5e-324, 1e-310]])),
    "log1p": (
        jnp.log1p,
        np.log1p,
        np.concatenate([RNG.uniform(-0.9, 5.0, 50_000), 1e-9 * RNG.normal(size=20_000), [0.0]]),
    ),
    "sqrt": (jnp.sqrt, np.sqrt, RNG.uniform(0.0, 1e6, 10_000)),
    "sin": (jnp.sin, np.sin, RNG.uniform(0.1, 3.0, 10_000)),
    "x**7": (lambda x: x**7, lambda x: x**7, RNG.normal(size=10_000)),
    "x**2.5": (lambda x: x**2.5, lambda x: x ** np.longdouble(2.5), RNG.uniform(0.1, 10.0, 10_000)),
    "logistic": (jax.nn.sigmoid, lambda x: 1.0 / (1.0 + np.exp(-x)), RNG.uniform(-30.0, 30.0, 10_000)),
}
LOOSER = {"x**7": 4.0, "x**2.5": 20.0, "logistic": 2.0, "log1p": 2.0}
"""Functions made of several others."""


@pytest.mark.parametrize("name", CASES)
def test_every_digit_counts(name):
    function, reference, x = CASES[name]
    true = reference(x.astype(np.longdouble))
    found = in_lanes(function)(x)
    assert np.all(np.abs(found - true) <= LOOSER.get(name, 1.0) * ROUNDING * np.abs(true))


@pytest.mark.parametrize("name", ["exp", "log", "log1p", "abs", "sign", "floor"])
def test_the_ends_of_the_range(name):
    function = getattr(jnp, name)
    x = np.array([np.nan, np.inf, -np.inf, 0.0, 709.78, 709.79, 1e308, -1e308, -1.0, 1.0])
    with np.errstate(all="ignore"):
        expected = getattr(np, name)(x)
    np.testing.assert_allclose(in_lanes(function)(x), expected, rtol=1e-12)


@pytest.mark.parametrize("name", ["maximum", "minimum"])
def test_what_is_not_a_number_stays_so(name):
    x = np.array([np.nan, 1.0, -1.0])
    found = in_lanes(lambda x: getattr(jnp, name)(x, 0.5))(x)
    np.testing.assert_array_equal(found, getattr(np, name)(x, 0.5))


def test_comparisons_of_what_is_not_a_number_are_false():
    x = np.array([np.nan, 1.0, 3.0])
    found = in_lanes(lambda x: jnp.where(x < 2.0, 1.0, jnp.where(x >= 2.0, 2.0, 3.0)))(x)
    np.testing.assert_array_equal(found, [3.0, 1.0, 2.0])
