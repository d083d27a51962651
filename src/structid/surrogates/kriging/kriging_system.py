"""The Kriging system: the factorised correlation matrix of the runs, and its solutions for a set of outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float

from structid.surrogates.covariance_factors import inverse_of, raised_cholesky

LARGEST_RAISED_NUGGET = 1e-5
"""Limit for raising the nugget against rounding errors; points that need more are too close to interpolate."""

SMALLEST_NUGGET = 1e-13
"""Nugget used if none is requested, so that rounding does not make the matrix indefinite."""


@dataclass(frozen=True, eq=False)
class KrigingData:
    """Data of a Kriging fit."""

    points: Float[np.ndarray, "run parameter"]  # standardised points
    trend: Float[np.ndarray, "run term"]  # F, trend terms at these points
    outputs: Float[np.ndarray, "run output"]  # y

    def some(self, rows: np.ndarray) -> KrigingData:
        """Select runs by their rows."""
        return KrigingData(self.points[rows], self.trend[rows], self.outputs[rows])


@dataclass(frozen=True, eq=False)
class KrigingFactors:
    """The solved Kriging system of a correlation matrix C = R + nugget · I and a set of outputs.

    With A = C⁻¹F and T = (FᵀC⁻¹F)⁻¹ the trend coefficients are β = T Aᵀ y and the weights w = C⁻¹(y − Fβ). With
    Q = C⁻¹ − A T Aᵀ the leave-one-out residuals are eᵢ = (Qy)ᵢ/Qᵢᵢ with variances σ²/Qᵢᵢ (Dubrule 1983,
    doi 10.1007/BF01033232).
    """

    cholesky: Float[np.ndarray, "run run"]  # Lower Cholesky factor of C
    nugget: float  # Nugget in C, including an increase because of rounding
    solved_trend: Float[np.ndarray, "run term"]  # A
    trend_covariance: Float[np.ndarray, "term term"]  # T
    coefficients: Float[np.ndarray, "term output"]  # β
    weights: Float[np.ndarray, "run output"]  # w
    leave_one_out_residuals: Float[np.ndarray, "run output"]  # e
    precision: Float[np.ndarray, " run"]  # Diagonal of Q
    likelihood_variance: Float[np.ndarray, " output"]  # σ² that maximises the likelihood

    @classmethod
    def of(cls, data: KrigingData, matrix: Float[np.ndarray, "run run"], nugget: float) -> KrigingFactors:
        """Factorise the correlation matrix and solve the system."""
        cholesky, nugget = raised_correlation_cholesky(matrix, nugget)
        solved_trend, trend_covariance, coefficients, weights = generalised_least_squares(data, cholesky)
        inverse = inverse_of(cholesky)
        precision = np.diag(inverse) - np.einsum("ij,jk,ik->i", solved_trend, trend_covariance, solved_trend)
        # Round-off can make it negative where the trend explains a run alone.
        precision = np.maximum(precision, np.finfo(np.float64).eps * np.diag(inverse))
        error = data.outputs - data.trend @ coefficients
        return cls(
            cholesky,
            nugget,
            solved_trend,
            trend_covariance,
            coefficients,
            weights,
            weights / precision[:, None],  # Qy = C⁻¹(y − Fβ)
            precision,
            np.sum(error * weights, axis=0) / len(error),
        )

    @property
    def cross_validated_variance(self) -> np.ndarray:
        """Variance σ² for which the standardised leave-one-out residuals have unit variance, shape (output,)."""
        return np.asarray(np.mean(self.leave_one_out_residuals**2 * self.precision[:, None], axis=0))


def raised_correlation_cholesky(matrix: Float[np.ndarray, "run run"], nugget: float) -> tuple[np.ndarray, float]:
    """Factorise C = R + nugget · I; if rounding makes it necessary, the nugget is raised up to a limit."""
    nugget = max(nugget, SMALLEST_NUGGET)
    return raised_cholesky(matrix, nugget, max(LARGEST_RAISED_NUGGET, 2.0 * nugget))


def generalised_least_squares(
    data: KrigingData, cholesky: Float[np.ndarray, "run run"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Solve generalised least squares for the trend: A = C⁻¹F, T = (FᵀA)⁻¹, β = T Aᵀy, w = C⁻¹(y − Fβ)."""
    # LAPACK is called directly: a search needs thousands of calls, and SciPy's checks take longer than small solutions.
    solved_trend, _ = scipy.linalg.lapack.dpotrs(cholesky, data.trend, lower=1)
    trend_covariance = np.linalg.inv(data.trend.T @ solved_trend)
    coefficients = trend_covariance @ (solved_trend.T @ data.outputs)
    weights, _ = scipy.linalg.lapack.dpotrs(cholesky, data.outputs - data.trend @ coefficients, lower=1)
    return solved_trend, trend_covariance, coefficients, weights
