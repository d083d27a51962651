"""Maps between ℝᵈ and a box: there and back, the same on the host as in JAX, with the slope that differences find."""

import numpy as np
import pytest

from structid.engine.device import jnp
from structid.probability.bijections import POINTS_AT_ONCE, Bijection, Scatter

BOX = np.array([[0.0, 1.0], [2.0, np.inf], [-np.inf, np.inf], [-np.inf, 3.0], [-1e6, 7e6]])
MAP = Bijection(BOX, scales=[1.0, 1.0, 5.0, 1.0, 1.0])
PHI = 2.0 * np.random.default_rng(0).normal(size=(50, 5))


# The third scatters about the fifth by the second.
TOGETHER = Bijection(BOX[[0, 1, 2, 2, 4]], [1.0, 1.0, 5.0, 2.0, 1.0], [Scatter(4, 1, (2, 3), 1e6, 3.0)])


def test_coordinates_of_what_scatters_are_those_of_the_scattered_value():
    theta, jacobian = TOGETHER(PHI)
    mean, sd, members = theta[:, [4]], theta[:, [1]], theta[:, 2:4]
    np.testing.assert_allclose(mean + sd * members, 1e6 + 3.0 * PHI[:, 2:4], rtol=1e-12)
    np.testing.assert_allclose(TOGETHER.inverse(theta), PHI, rtol=1e-6, atol=1e-6)
    for host, device in zip((theta, jacobian), TOGETHER.forward(jnp.asarray(PHI)), strict=True):
        np.testing.assert_allclose(host, device, rtol=1e-12, atol=1e-12)
    # |∂θ/∂φ| by differences: a full matrix, since b depends on μ and d too.
    point, step = PHI[0], 1e-5
    columns = [(TOGETHER(point[None] + step * e)[0] - TOGETHER(point[None] - step * e)[0])[0] for e in np.eye(5)]
    _, expected = np.linalg.slogdet(np.stack(columns) / (2.0 * step))
    np.testing.assert_allclose(jacobian[0], expected, rtol=1e-5)
    assert Bijection(TOGETHER.bounds, TOGETHER.scales) != TOGETHER


def test_on_the_host_and_in_jax_it_is_the_same():
    for phi in (PHI, np.full((1, 5), 900.0), np.full((1, 5), -900.0)):
        for host, device in zip(MAP(phi), MAP.forward(jnp.asarray(phi)), strict=True):
            np.testing.assert_allclose(host, device, rtol=1e-13, atol=1e-13)


def test_there_and_back():
    theta, _ = MAP(PHI)
    assert (theta > BOX[:, 0]).all() and (theta < BOX[:, 1]).all()
    np.testing.assert_allclose(MAP.inverse(theta), PHI, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(MAP.inverse(theta[0]), PHI[0], rtol=1e-9, atol=1e-9)
    outside = MAP.inverse(np.array([-0.1, 1.0, 0.0, 4.0, 8e6]))
    assert np.isnan(outside[[0, 1, 3, 4]]).all() and outside[2] == 0.0


def test_the_jacobian_is_the_product_of_the_slopes():
    step = 1e-6
    slopes = (MAP(PHI + step)[0] - MAP(PHI - step)[0]) / (2.0 * step)
    np.testing.assert_allclose(MAP(PHI)[1], np.log(np.abs(slopes)).sum(axis=1), atol=1e-6)


@pytest.mark.parametrize(
    ("bounds", "scales", "same"), [(BOX, MAP.scales, True), (BOX, None, False), (BOX + 1.0, MAP.scales, False)]
)
def test_maps_of_the_same_box_are_equal(bounds, scales, same):
    other = Bijection(bounds, scales)
    assert (other == MAP) is same and (hash(other) == hash(MAP)) is same


def test_logarithms_within_two_bounds():
    """Their image is wider than the box; elsewhere it is the plain map."""
    bounds = np.array([[2.0, 5.0], [-1.0, 1.0], [1e3, 1e4]])
    plain, by_logarithm = Bijection(bounds), Bijection(bounds, logarithmic=(0, 2))
    assert plain != by_logarithm and hash(plain) != hash(by_logarithm) and (by_logarithm.bounds == bounds).all()
    theta = np.array([[3.0, 0.5, 2e3], [2.0, -0.9, 1e4]])
    phi = by_logarithm.inverse(theta)
    np.testing.assert_allclose(phi[:, [0, 2]], np.log(theta[:, [0, 2]]))
    np.testing.assert_array_equal(phi[:, 1], plain.inverse(theta)[:, 1])
    back, jacobian = by_logarithm(phi)
    np.testing.assert_allclose(back, theta, rtol=1e-14)
    inside, traced = by_logarithm.forward(phi)
    np.testing.assert_allclose(inside, theta, rtol=1e-14)
    np.testing.assert_allclose(traced, jacobian, rtol=1e-12)
    slopes = (by_logarithm(phi + 1e-6)[0] - by_logarithm(phi - 1e-6)[0]) / 2e-6
    np.testing.assert_allclose(np.log(slopes).sum(axis=1), jacobian, rtol=1e-7)


def test_many_points_are_mapped_as_a_few():
    many = np.tile(PHI, (POINTS_AT_ONCE // len(PHI) + 2, 1))
    theta, jacobian = TOGETHER(many)
    few = [TOGETHER(PHI)] * (len(many) // len(PHI))
    np.testing.assert_array_equal(theta, np.concatenate([of[0] for of in few]))
    np.testing.assert_array_equal(jacobian, np.concatenate([of[1] for of in few]))
