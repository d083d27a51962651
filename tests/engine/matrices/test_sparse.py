"""Sparse products and solutions, and loops that each run leaves when it is done: what JAX gets, whoever is beside a run."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from structid.engine.device import over_runs
from structid.engine.lanes.in_lanes import InLanes
from structid.engine.matrices.block_sparse import BlockPattern, SparseMatrix
from structid.engine.matrices.elimination import elimination

pytestmark = pytest.mark.quick

RNG = np.random.default_rng(5)
SIZE = 9
TOUCHING = (RNG.random((SIZE, SIZE)) < 0.2) | (RNG.random((SIZE, SIZE)) < 0.2).T
PATTERN = BlockPattern.of(TOUCHING | TOUCHING.T)
MATRIX = SparseMatrix(np.where(RNG.random((2 * SIZE, 5)) < 0.4, RNG.normal(size=(2 * SIZE, 5)), 0.0))
BLOCKS = 0.2 * RNG.normal(size=(len(PATTERN.rows), 2, 2))
ROWS = RNG.normal(size=(37, 3))


def through_lanes(function, rows=ROWS):
    """What a function of rows, with a loop over time around it, gives in lanes and by JAX."""

    def looped(theta, record):
        _, seen = jax.lax.scan(lambda _, force: (None, function(theta, force)), None, record)
        return seen

    record = np.linspace(0.5, 1.5, 20)
    lanes = InLanes(looped, run_axes=2)
    found = lanes(rows, record)
    assert lanes.why_not == ""
    return found, over_runs(looped, 2)(rows, record)


def test_products_with_a_matrix_that_all_share():
    def function(theta, force):
        return MATRIX.times(jnp.concatenate([theta.T, force * theta.T[:2]]))

    found, expected = through_lanes(function)
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("solving", [False, True])
def test_products_and_solutions_with_a_matrix_of_each_run(solving):
    def function(theta, force):
        by = jnp.stack([jnp.exp(0.2 * theta[:, 0]), jnp.cos(theta[:, 1])])
        blocks = jnp.asarray(BLOCKS)[..., None] * by[0]
        right = force * jnp.concatenate([theta.T] * 6)
        if not solving:
            return PATTERN.times(blocks, right)
        diagonal = jnp.broadcast_to(
            jnp.array([[1.0, 0.3], [-0.2, 0.5]])[None, ..., None] * by[1], (SIZE, 2, 2, len(theta))
        )
        return PATTERN.solve_one_plus(blocks, diagonal, right)

    found, expected = through_lanes(function)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


def test_derivatives_along_several_directions_at_once():
    """Of products in all that they take; of solutions in their right sides, with one matrix for all directions."""

    def products(theta, force):
        blocks = jnp.asarray(BLOCKS)[..., None] * jnp.exp(0.2 * theta[:, 0])
        of_all = MATRIX.times(jnp.concatenate([jnp.sin(theta.T), force * theta.T[:2]]))
        return PATTERN.times(blocks, of_all)

    def slopes(theta, force):
        def along(direction):
            tangent = jnp.broadcast_to(direction, theta.shape)
            return jax.jvp(lambda at: products(at, force), (theta,), (tangent,))

        value, slopes = jax.vmap(along, out_axes=(None, 0))(jnp.eye(3))
        blocks = jnp.asarray(BLOCKS)[..., None] * jnp.cos(theta[:, 1])
        diagonal = jnp.broadcast_to(jnp.eye(2)[None, ..., None], (SIZE, 2, 2, len(theta)))
        solved = jax.vmap(lambda right: PATTERN.solve_one_plus(blocks, diagonal, right))(slopes)
        return jnp.concatenate([value[None], slopes, solved]).reshape(-1, len(theta))

    found, expected = through_lanes(slopes)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)
    step, second = 1e-6, slice(4 * SIZE, 6 * SIZE)  # the value comes first, then a slope along each parameter
    ends = [through_lanes(products, ROWS + sign * step * np.eye(3)[1])[0] for sign in (1.0, -1.0)]
    np.testing.assert_allclose(found[:, second], (ends[0] - ends[1]) / (2.0 * step), atol=1e-8)


def test_the_elimination_fills_in_what_it_says():
    """LU of a random matrix with the pattern, in the planned order, has no number at another place."""
    plan = elimination(PATTERN.rows, PATTERN.columns, SIZE)
    pattern = np.zeros((SIZE, SIZE), dtype=bool)
    pattern[PATTERN.rows, PATTERN.columns] = True
    a = np.where(pattern, RNG.random((SIZE, SIZE)), 0.0)[np.ix_(plan.order, plan.order)] + 10.0 * np.eye(SIZE)
    for k in range(SIZE):
        a[k + 1 :, k] /= a[k, k]
        a[k + 1 :, k + 1 :] -= np.outer(a[k + 1 :, k], a[k, k + 1 :])
    assert np.count_nonzero(a) == plan.count == len(plan.below) + len(plan.beside) + SIZE
    assert plan.count < SIZE**2


def square_root(theta, force):
    """Newton iterations until they stand still: a few, or many."""
    wanted = force * jnp.exp(3.0 * theta.T)

    def iterate(carried):
        x, going, count = carried
        moved = 0.5 * (x + wanted / x)
        near = jnp.max(jnp.abs(moved - x), axis=0) <= 1e-14 * jnp.max(moved, axis=0)
        return jnp.where(going, moved, x), going & ~near, count + 1.0

    start = (jnp.ones_like(wanted), jnp.ones(wanted.shape[1], dtype=bool), 0.0)
    found, _, _ = jax.lax.while_loop(lambda c: jnp.any(c[1]) & (c[2] < 60.0), iterate, start)
    return found


def test_a_loop_that_each_run_leaves_when_it_is_done():
    found, expected = through_lanes(square_root)
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    np.testing.assert_allclose(found[0], np.sqrt(0.5 * np.exp(3.0 * ROWS.T)), rtol=1e-14)


def test_the_bits_of_a_run_do_not_depend_on_those_beside_it():
    together, _ = through_lanes(square_root)
    for number in (0, 11, 36):
        alone, _ = through_lanes(square_root, ROWS[number : number + 1])
        np.testing.assert_array_equal(alone[:, :, 0], together[:, :, number])
