"""Products with large matrices: the same in loops over their rows as by JAX."""

import jax
import numpy as np
import pytest

from structid.engine.device import jnp
from structid.engine.lanes import machine
from structid.engine.lanes.in_lanes import InLanes
from structid.engine.matrices.row_by_row import COLUMNS, product, product_of

pytestmark = [pytest.mark.quick, pytest.mark.skipif(bool(machine.why_not()), reason="no lanes here")]

RNG = np.random.default_rng(7)
THETA = RNG.normal(size=(21, 3))


def distances(theta, points):
    return jnp.sqrt(1.0 + ((theta[:, None] - points[None]) ** 2).sum(axis=2))


@pytest.mark.parametrize("columns", [1, COLUMNS - 1, COLUMNS, 3 * COLUMNS + 2])
@pytest.mark.parametrize("rows", [1, 5, 300])
def test_products_with_what_a_function_makes(rows, columns):
    points, matrix = RNG.normal(size=(rows, 3)), RNG.normal(size=(rows, columns))
    ours = InLanes(lambda theta, *given: product_of(lambda some: distances(theta, some), *given))
    expected = np.asarray(distances(THETA, points)) @ matrix
    np.testing.assert_allclose(ours(THETA, points, matrix), expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    assert not ours.why_not


@pytest.mark.parametrize("columns", [1, 100])
def test_products_of_numbers_that_a_run_has(columns):
    matrix = RNG.normal(size=(30, columns))

    def function(theta, matrix):
        values = jnp.tile(jnp.sin(theta), (1, 10))
        return product(values, matrix)

    ours, expected = InLanes(function), np.tile(np.sin(THETA), (1, 10)) @ matrix
    np.testing.assert_allclose(ours(THETA, matrix), expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    assert not ours.why_not


def test_outside_lanes_they_are_plain_products():
    matrix = RNG.normal(size=(3, 40))
    operations = jax.make_jaxpr(product)(THETA, matrix).eqns
    assert [operation.primitive.name for operation in operations] == ["dot_general"]
