"""Four-node plane-stress blocks and two-node bars: stiffness and consistent mass, by 2 × 2 Gauss points.

Source: K.-J. Bathe (2014), Finite Element Procedures, 2nd ed., section 5.3.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

GAUSS = np.array([-1.0, 1.0]) / np.sqrt(3.0)
"""Points of the two-point Gauss rule, with unit weights."""
CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""Natural coordinates of the nodes."""


def shape_functions(r: float, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the bilinear shape functions N_i = ¼ (1 + r_i r)(1 + s_i s) and their derivatives."""
    r_i, s_i = CORNERS.T
    values = 0.25 * (1.0 + r_i * r) * (1.0 + s_i * s)
    slopes = 0.25 * np.array([r_i * (1.0 + s_i * s), s_i * (1.0 + r_i * r)])
    return values, slopes


def strain_matrix(corners: Float[np.ndarray, "4 2"], r: float, s: float) -> tuple[np.ndarray, float]:
    """Return the matrix B of the strains ε = (ε_x, ε_y, γ_xy) = B u at a point."""
    _, slopes = shape_functions(r, s)
    jacobian = slopes @ corners
    d_x, d_y = np.linalg.solve(jacobian, slopes)
    b = np.zeros((3, 8))
    b[0, 0::2], b[1, 1::2], b[2, 0::2], b[2, 1::2] = d_x, d_y, d_y, d_x
    return b, float(np.linalg.det(jacobian))


def plane_stress(modulus: float, poisson: float) -> Float[np.ndarray, "3 3"]:
    """Return the matrix D of σ = D ε in plane stress."""
    d = np.array([[1.0, poisson, 0.0], [poisson, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - poisson)]])
    return np.asarray(modulus / (1.0 - poisson**2) * d)


def block_stiffness(
    corners: Float[np.ndarray, "4 2"], thickness: float, modulus: float, poisson: float
) -> Float[np.ndarray, "8 8"]:
    """Return the stiffness matrix K = t ∫ Bᵀ D B dA."""
    material, k = plane_stress(modulus, poisson), np.zeros((8, 8))
    for r in GAUSS:
        for s in GAUSS:
            b, determinant = strain_matrix(corners, r, s)
            k += thickness * determinant * b.T @ material @ b
    return k


def block_mass(corners: Float[np.ndarray, "4 2"], thickness: float, density: float) -> Float[np.ndarray, "8 8"]:
    """Return the consistent mass matrix M = ρ t ∫ Nᵀ N dA."""
    m = np.zeros((8, 8))
    for r in GAUSS:
        for s in GAUSS:
            values, slopes = shape_functions(r, s)
            of_one = density * thickness * float(np.linalg.det(slopes @ corners)) * np.outer(values, values)
            m[0::2, 0::2] += of_one
            m[1::2, 1::2] += of_one
    return m
