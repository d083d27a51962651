"""Blocks: the patch test, rigid motions, mass, and a cantilever by beam theory."""

import numpy as np
import pytest

from structid.models.masonry.finite_elements.elements import block_mass, block_stiffness, plane_stress, strain_matrix

SKEWED = np.array([[0.0, 0.0], [1.1, 0.1], [1.3, 0.9], [-0.1, 0.7]])
E, NU, T, RHO = 4.21e9, 0.2, 0.15, 1000.0


@pytest.mark.parametrize("gradient", [(1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 1.0, 0.0), (0.3, -0.2, 0.7, 0.5)])
def test_patch(gradient):
    """A linear displacement gives its strain everywhere, and nodal forces that are those of its constant stress."""
    a, b, c, d = gradient
    u = (SKEWED @ np.array([[a, c], [b, d]])).reshape(-1)
    strain = np.array([a, d, b + c])
    for r, s in ((0.0, 0.0), (0.3, -0.8), (1.0, 1.0)):
        np.testing.assert_allclose(strain_matrix(SKEWED, r, s)[0] @ u, strain, atol=1e-14)
    forces = (block_stiffness(SKEWED, T, E, NU) @ u).reshape(4, 2)
    sx, sy, txy = plane_stress(E, NU) @ strain
    expected = np.zeros((4, 2))
    for i in range(4):
        j = (i + 1) % 4
        (dx, dy) = SKEWED[j] - SKEWED[i]
        edge = 0.5 * T * np.array([sx * dy - txy * dx, txy * dy - sy * dx])
        expected[i] += edge
        expected[j] += edge
    np.testing.assert_allclose(forces, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max() + 1e-6)


def test_rigid_motions_and_mass():
    k, m = block_stiffness(SKEWED, T, E, NU), block_mass(SKEWED, T, RHO)
    area = 0.5 * abs(sum(np.cross(SKEWED[i], SKEWED[(i + 1) % 4]) for i in range(4)))
    for motion in (np.tile([1.0, 0.0], 4), np.tile([0.0, 1.0], 4), (SKEWED[:, ::-1] * [-1.0, 1.0]).reshape(-1)):
        assert np.abs(k @ motion).max() < 1e-6
    assert np.tile([1.0, 0.0], 4) @ m @ np.tile([1.0, 0.0], 4) == pytest.approx(RHO * T * area)
    assert np.linalg.eigvalsh(k)[3] > 1e6  # three rigid motions, no more
