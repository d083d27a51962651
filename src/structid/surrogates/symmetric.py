"""Factors of covariance matrices that rounding may have left indefinite."""

from __future__ import annotations

import numpy as np
import scipy.linalg


def raised_cholesky(matrix: np.ndarray, diagonal: float, largest: float = np.inf) -> tuple[np.ndarray, float]:
    """Lower factor of matrix + diagonal · I, the diagonal raised to where that is positive definite.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Symmetric.
    diagonal : float
        Positive; tried first.
    largest : float
        It is not raised to this or beyond.

    Returns
    -------
    tuple of ndarray and float
        The factor and the diagonal it took.

    Raises
    ------
    numpy.linalg.LinAlgError
        If none below the largest will do.
    """
    while diagonal < largest:
        shifted = matrix.copy()
        shifted[np.diag_indices_from(shifted)] += diagonal
        factor, failed = scipy.linalg.lapack.dpotrf(shifted.T, lower=1, clean=1, overwrite_a=1)
        if not failed:
            return np.asarray(factor), diagonal
        diagonal *= 30.0
    raise np.linalg.LinAlgError("not positive definite")


def inverse_of(cholesky: np.ndarray) -> np.ndarray:
    """(L Lᵀ)⁻¹, both triangles.

    Parameters
    ----------
    cholesky : ndarray, shape (n, n)
        L, lower.

    Returns
    -------
    ndarray, shape (n, n)
        The inverse.
    """
    lower, _ = scipy.linalg.lapack.dpotri(cholesky, lower=1)
    return np.asarray(np.tril(lower) + np.tril(lower, -1).T)
