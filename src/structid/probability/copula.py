"""The Gaussian copula: correlation between parameters of any marginal distributions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.arrays import Array
from structid.core.errors import InputError, suggestion


def correlation_matrix(
    given: Mapping[tuple[str, str], float] | np.ndarray | None, names: Sequence[str]
) -> Float[np.ndarray, "parameter parameter"] | None:
    """Build and check the correlation matrix of a Gaussian copula."""
    if given is None or len(names) == 0:
        return None
    matrix = _of_pairs(given, names) if isinstance(given, Mapping) else np.array(given, dtype=np.float64)
    shape = (len(names), len(names))
    if matrix.shape != shape or not np.allclose(matrix, matrix.T) or not np.allclose(np.diag(matrix), 1.0):
        raise InputError(
            "correlation",
            f"an array of shape {matrix.shape}",
            f"a symmetric {shape} matrix with ones on its diagonal",
        )
    if np.linalg.eigvalsh(matrix).min() <= 1e-10:
        raise InputError(
            "correlation",
            f"a matrix whose smallest eigenvalue is {np.linalg.eigvalsh(matrix).min():.2g}",
            "a positive definite matrix",
            "Use weaker correlations: together they contradict each other.",
        )
    return matrix


def _of_pairs(given: Mapping[tuple[str, str], float], names: Sequence[str]) -> np.ndarray:
    matrix = np.eye(len(names))
    for pair, value in given.items():
        for name in pair:
            if name not in names:
                raise InputError("correlation", f"unknown name '{name}'", ", ".join(names), suggestion(name, names))
        if not -1.0 < value < 1.0:
            raise InputError(f"correlation of {' and '.join(pair)}", f"{value!r}", "a number between -1 and 1")
        i, j = (names.index(n) for n in pair)
        matrix[i, j] = matrix[j, i] = value
    return matrix


def correlated(
    u: Float[np.ndarray, "... parameter"], correlation: Float[np.ndarray, "parameter parameter"]
) -> Float[np.ndarray, "... parameter"]:
    """Correlate independent uniform numbers, Φ(L Φ⁻¹(u)) with R = L Lᵀ."""
    z = scipy.special.ndtri(u) @ np.linalg.cholesky(correlation).T
    result: np.ndarray = scipy.special.ndtr(z)
    return result


def decorrelated(
    u: Float[np.ndarray, "... parameter"], correlation: Float[np.ndarray, "parameter parameter"]
) -> Float[np.ndarray, "... parameter"]:
    """Make correlated uniform numbers independent, Φ(L⁻¹ Φ⁻¹(u)); the inverse of `correlated`."""
    z = np.linalg.solve(np.linalg.cholesky(correlation), scipy.special.ndtri(u)[..., None])[..., 0]
    result: np.ndarray = scipy.special.ndtr(z)
    return result


def copula_log_density(
    z: Float[Array, "... parameter"], correlation: Float[np.ndarray, "parameter parameter"], numpy: Any
) -> Float[Array, " ..."]:
    """Log density of the Gaussian copula, log c = −½ log|R| − ½ zᵀ(R⁻¹ − I) z."""
    excess = np.linalg.inv(correlation) - np.eye(len(correlation))
    return -0.5 * np.linalg.slogdet(correlation)[1] - 0.5 * numpy.einsum("...i,ij,...j->...", z, excess, z)
