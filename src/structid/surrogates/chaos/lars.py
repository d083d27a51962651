"""Sparse regression: order the terms, fit nested sets by least squares, select their number by leave-one-out error.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float, Int

OPTIMISM = 0.25
"""Forward selection is preferred only if its leave-one-out error is below this fraction of the error of least angle
regression. Forward selection uses the same data for selection and assessment, so its leave-one-out error is more optimistic.
In tests with smooth functions it is more accurate by factors of 10 to 10⁵; for functions with kinks, its leave-one-out
error is a third too small."""

FIRST_PATH = 120
"""Number of terms of the first path. The path is doubled while the best model is near the end of the path."""


@dataclass(frozen=True, eq=False)
class NestedFits:
    """Least squares on the first 1, 2, … columns of a matrix."""

    residual_variance: Float[np.ndarray, " size"]  # Mean squared residual
    leave_one_out: Float[np.ndarray, " size"]  # Mean squared leave-one-out residual
    # Correction for overfitting, N/(N − P) (1 + tr (ΨᵀΨ)⁻¹); infinite from the first linearly dependent column onwards
    correction: Float[np.ndarray, " size"]

    @property
    def corrected(self) -> np.ndarray:
        """Corrected mean squared leave-one-out residual, shape (size,)."""
        return np.asarray(self.leave_one_out * self.correction)


def nested_least_squares(columns: Float[np.ndarray, "run term"], response: Float[np.ndarray, " run"]) -> NestedFits:
    """Compute residuals and leave-one-out residuals of every nested model from one QR factorisation.

    With Ψ = QR the hat matrix of the first P columns is Q_P Q_Pᵀ. Both the residual y − Q_P Q_Pᵀ y and the leverages
    h = Σ qᵢ² are therefore running sums, and the leave-one-out residual is (y − ŷ)/(1 − h) (thesis eq. 2.41). R_P⁻¹ is the
    leading block of R⁻¹, so tr (ΨᵀΨ)⁻¹ = ‖R_P⁻¹‖² is a running sum too. Correction: Chapelle, Vapnik & Bengio 2002.
    """
    runs, terms = columns.shape
    q, r = np.linalg.qr(columns)
    residual = response[:, None] - np.cumsum(q * (response @ q), axis=1)
    leverage = np.cumsum(q**2, axis=1)
    size = np.arange(1, terms + 1)
    dependent = np.maximum.accumulate(np.abs(np.diag(r)) < 1e-10 * np.abs(r[0, 0])) | (size >= runs)
    inverse = scipy.linalg.solve_triangular(np.where(np.diag(dependent), np.eye(terms), r), np.eye(terms))
    with np.errstate(divide="ignore", invalid="ignore"):
        left_out = residual / np.maximum(1.0 - leverage, 1e-12)
        correction = runs / (runs - size) * (1.0 + np.cumsum(np.sum(inverse**2, axis=0)))
    correction[dependent] = np.inf
    return NestedFits(np.mean(residual**2, axis=0), np.mean(left_out**2, axis=0), correction)


def least_angle_order(
    gram: Float[np.ndarray, "term term"], covariance: Float[np.ndarray, " term"], runs: int, most: int
) -> np.ndarray:
    """Return the order in which least angle regression adds terms (Efron et al. 2004, doi 10.1214/009053604000000067)."""
    from sklearn.linear_model import lars_path_gram  # scikit-learn takes a second to import

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of linearly dependent terms, and omits them
        _, active, _ = lars_path_gram(
            covariance,
            gram,
            n_samples=runs,
            method="lar",
            max_iter=most,
            return_path=False,
            copy_X=True,
            copy_Gram=True,
        )
    return np.asarray(active, dtype=int)


@dataclass(frozen=True, eq=False)
class SparseFit:
    """A sparse least-squares model."""

    active: Int[np.ndarray, " active"]  # Selected columns
    coefficients: Float[np.ndarray, " active"]
    leave_one_out_error: float  # Corrected leave-one-out error relative to the variance of the response


def orthogonal_order(
    gram: Float[np.ndarray, "term term"], covariance: Float[np.ndarray, " term"], most: int
) -> np.ndarray:
    """Return the order in which orthogonal least squares adds terms; each added term reduces the residual most.

    The algorithm uses only inner products. It is a Cholesky factorisation whose pivot is the term with the largest error reduction
    c²/d. For the part of a term orthogonal to the selected terms, d is the squared norm, and c is the inner product with the
    residual (Chen, Billings & Luo 1989, doi 10.1080/00207178908953472).
    """
    factor = np.zeros((most, len(gram)))
    norm, inner = np.diag(gram).copy(), covariance.astype(np.float64).copy()
    smallest = 1e-12 * norm
    order: list[int] = []
    for step in range(most):
        gain = np.where(norm > smallest, inner**2 / np.maximum(norm, 1e-300), -1.0)
        gain[order] = -1.0
        pivot = int(np.argmax(gain))
        if gain[pivot] <= 0.0:
            break
        root = np.sqrt(norm[pivot])
        row = (gram[pivot] - factor[:step, pivot] @ factor[:step]) / root
        factor[step] = row
        inner -= row * (inner[pivot] / root)
        norm -= row**2
        order.append(pivot)
    return np.array(order, dtype=int)


class SparseRegression:
    """Sparse least squares of many responses on one design matrix.

    The terms are ordered by least angle regression or orthogonal least squares. Ordinary least squares then uses the first
    1, 2, … terms. The model with the smallest corrected leave-one-out error is kept (Blatman & Sudret 2011,
    doi 10.1016/j.jcp.2010.12.021).
    """

    def __init__(self, columns: Float[np.ndarray, "run term"], method: str = "sparse") -> None:
        self.columns, self.method = columns, method
        centred = columns[:, 1:] - columns[:, 1:].mean(axis=0)
        norm = np.sqrt(np.sum(centred**2, axis=0))
        self._varying = np.flatnonzero(norm > 1e-12 * norm.max(initial=1.0))
        self._standard = centred[:, self._varying] / norm[self._varying]
        self._gram = self._standard.T @ self._standard

    def fit(self, response: Float[np.ndarray, " run"]) -> SparseFit:
        """Fit one response."""
        if self.method != "sparse":
            return self._along(response, self.method)
        lars, forward = self._along(response, "lars"), self._along(response, "forward")
        clear = forward.leave_one_out_error < OPTIMISM * lars.leave_one_out_error
        return forward if clear else lars

    def _along(self, response: np.ndarray, method: str) -> SparseFit:
        """Return the best nested model along one order of the terms."""
        covariance = self._standard.T @ (response - response.mean())
        limit = min(len(response) // 2, len(self._varying))
        most = min(FIRST_PATH, limit)
        while True:
            order = self._order(covariance, len(response), most, method)
            columns = np.concatenate([[0], 1 + self._varying[order]])
            fits = nested_least_squares(self.columns[:, columns], response)
            best = int(np.argmin(fits.corrected))
            if most >= limit or best < 0.7 * most:
                break
            most = min(2 * most, limit)
        active = columns[: best + 1]
        coefficients = least_squares(self.columns[:, active], response)
        return SparseFit(active, coefficients, float(fits.corrected[best] / response.var()))

    def _order(self, covariance: np.ndarray, runs: int, most: int, method: str) -> np.ndarray:
        if most <= 0:
            return np.empty(0, dtype=int)
        if method == "forward":
            return orthogonal_order(self._gram, covariance, most)
        return least_angle_order(self._gram, covariance, runs, most)


def least_squares(
    columns: Float[np.ndarray, "run term"], response: Float[np.ndarray, " run"]
) -> Float[np.ndarray, " term"]:
    """Solve ordinary least squares, c = (ΨᵀΨ)⁻¹ Ψᵀ y (thesis eq. 2.39), by QR factorisation."""
    q, r = np.linalg.qr(columns)
    return np.asarray(scipy.linalg.solve_triangular(r, q.T @ response))
