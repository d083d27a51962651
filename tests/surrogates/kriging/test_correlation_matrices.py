"""Correlation matrices on the host, and derivatives of their weighted sums, against JAX."""

import pickle

import jax
import numpy as np
import pytest

from structid.engine.device import jnp
from structid.surrogates.kriging import correlation_matrices
from structid.surrogates.kriging.correlation_matrices import CorrelationMatrices
from structid.surrogates.kriging.correlations import FAMILIES, correlation

pytestmark = pytest.mark.quick


@pytest.fixture(autouse=True, params=[True, False], ids=["numpy", "compiled"])
def small(request, monkeypatch):
    """Small designs go by NumPy, large ones by compiled code: here the same design by both."""
    monkeypatch.setattr(correlation_matrices, "SMALL_DESIGN", 10**6 if request.param else 0)


RNG = np.random.default_rng(2)
POINTS, OTHERS = RNG.normal(size=(37, 3)), RNG.normal(size=(5, 3))
LOG_LENGTHS = np.array([-0.5, 0.3, 1.2])


@pytest.mark.parametrize("separable", [True, False])
@pytest.mark.parametrize("family", FAMILIES)
def test_every_correlation(family, separable):
    matrices = CorrelationMatrices(family, separable, POINTS)
    expected = correlation(family, separable, POINTS, OTHERS, LOG_LENGTHS)
    np.testing.assert_allclose(matrices.with_points(OTHERS, LOG_LENGTHS), expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.diag(matrices.of(LOG_LENGTHS)), 1.0, rtol=1e-15)


def test_they_can_be_sent():
    matrices = CorrelationMatrices("matern52", True, POINTS)
    expected = matrices.with_points(OTHERS, LOG_LENGTHS)
    sent = pickle.loads(pickle.dumps(matrices))
    np.testing.assert_array_equal(sent.with_points(OTHERS, LOG_LENGTHS), expected)


@pytest.mark.parametrize("separable", [True, False])
@pytest.mark.parametrize("family", FAMILIES)
def test_every_gradient(family, separable):
    weights = RNG.normal(size=(37, 37))
    found = CorrelationMatrices(family, separable, POINTS).gradient(LOG_LENGTHS, weights)
    expected = jax.grad(lambda lengths: jnp.sum(weights * correlation(family, separable, POINTS, POINTS, lengths)))
    np.testing.assert_allclose(found, expected(LOG_LENGTHS), rtol=1e-10)


@pytest.mark.parametrize("separable", [True, False])
@pytest.mark.parametrize("family", FAMILIES)
def test_several_sets_of_lengths_at_once(family, separable, monkeypatch):
    matrices, lengths = CorrelationMatrices(family, separable, POINTS), LOG_LENGTHS + RNG.normal(size=(5, 3))
    each = np.stack([matrices.of(one) for one in lengths])
    np.testing.assert_array_equal(list(matrices.of_several(lengths)), each)
    monkeypatch.setattr(correlation_matrices, "LARGEST_CALL", 2 * 37**2)  # in three calls
    monkeypatch.setattr(correlation_matrices, "CACHED", 37**2)
    np.testing.assert_array_equal(list(matrices.of_several(lengths)), each)
