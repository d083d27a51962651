"""Factors and inverses of covariance matrices that may be indefinite because of rounding errors."""

from __future__ import annotations

import numpy as np
import scipy
from jaxtyping import Float


def raised_cholesky(
    matrix: Float[np.ndarray, "n n"], diagonal: float, largest: float = np.inf
) -> tuple[np.ndarray, float]:
    """Factorise matrix + diagonal · I; raise the diagonal until the sum is positive definite."""
    while diagonal < largest:
        shifted = matrix.copy(order="C")
        shifted.reshape(-1)[:: len(matrix) + 1] += diagonal
        factor, failed = scipy.linalg.lapack.dpotrf(shifted.T, lower=1, clean=1, overwrite_a=1)
        if not failed:
            return np.asarray(factor), diagonal
        diagonal *= 30.0
    raise np.linalg.LinAlgError("not positive definite")


def inverse_of(cholesky: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Compute (L Lᵀ)⁻¹ from a Cholesky factor L."""
    lower, _ = scipy.linalg.lapack.dpotri(cholesky, lower=1)
    whole = lower + lower.T
    np.fill_diagonal(whole, np.diag(lower))
    return np.asarray(whole)
