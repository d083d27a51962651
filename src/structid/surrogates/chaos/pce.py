"""Settings and fit of a polynomial chaos expansion: selection of terms, and their coefficients.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from structid.core.errors import InputError, check_choice
from structid.core.progress import Progress
from structid.core.validation import check_arguments
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace
from structid.surrogates.chaos.chaos_expansion import ChaosExpansion
from structid.surrogates.chaos.lars import SparseFit, SparseRegression, least_squares, nested_least_squares
from structid.surrogates.chaos.multi_indices import by_degree, multi_indices
from structid.surrogates.chaos.polynomial_basis import PolynomialBasis
from structid.surrogates.chaos.shrinkage import fit_shrunk
from structid.surrogates.regression import check_training

PATIENCE = 2
"""Number of successive degrees without a smaller leave-one-out error after which a degree-adaptive fit stops."""
LARGEST_SEARCHED = 6000
"""Number of terms at which a search over degrees stops, once a model is found. A single degree may have more terms."""

METHODS = ("sparse", "lars", "forward", "ols", "shrinkage")
"""Methods that select the terms and determine their coefficients."""


@check_arguments
@dataclass(frozen=True)
class PCE:
    """Settings of a polynomial chaos expansion, f(θ) ≈ Σ_α c_α Ψ_α(θ) (thesis eq. 2.34).

    Parameters
    ----------
    degree : int or sequence of int
        Largest total degree. If several are given, each output uses the degree with the smallest leave-one-out error.
        The search stops early when this error no longer decreases.
    hyperbolic_norm : float or sequence of float
        q of the hyperbolic truncation, in (0, 1]. If several are given, each output uses the best.
    interaction : int, optional
        Largest number of parameters in one term.
    method : {"sparse", "lars", "forward", "ols", "shrinkage"}
        Selection of the terms. ``"lars"`` uses least angle regression, ``"forward"`` forward orthogonal least squares.
        ``"sparse"`` uses ``"forward"`` if its leave-one-out error is clearly smaller, and ``"lars"`` otherwise.
        ``"ols"`` is ordinary least squares on the whole basis. ``"shrinkage"`` keeps many more terms than runs. Its
        coefficients shrink with the degree, at rates that are estimated from the runs and shared by all outputs;
        `degree`, `hyperbolic_norm` and `interaction` are then not used.

    Examples
    --------
    >>> import structid as si
    >>> space = si.ParameterSpace(a=si.Uniform(0.0, 1.0))
    >>> design = space.sample(20, seed=1)
    >>> fitted = si.PCE(degree=3).fit(design, design.values**3)
    >>> bool(fitted.leave_one_out_error.max() < 1e-12)
    True
    """

    degree: int | Sequence[int] = tuple(range(1, 16))
    hyperbolic_norm: float | Sequence[float] = (0.5, 0.75, 1.0)
    interaction: int | None = None
    method: Literal["sparse", "lars", "forward", "ols", "shrinkage"] = "sparse"

    def __post_init__(self) -> None:
        check_choice("PCE.method", self.method, METHODS)
        for degree in np.atleast_1d(self.degree):
            for norm in np.atleast_1d(self.hyperbolic_norm):
                multi_indices(1, degree, float(norm), self.interaction)

    def check_runs(self, dimension: int, runs: int) -> None:
        """Check that there are enough runs for the smallest basis; ordinary least squares needs more runs than terms.

        Parameters
        ----------
        dimension : int
            Number of parameters.
        runs : int
            Number of runs, finished or planned.

        Raises
        ------
        InputError
            If there are too few runs.
        """
        if self.method != "ols":
            return
        norm = float(np.min(self.hyperbolic_norm))
        terms = len(multi_indices(dimension, int(np.min(self.degree)), norm, self.interaction))
        if terms >= runs:
            raise InputError(
                "PCE.fit",
                f"{runs} runs for a basis of {terms} terms",
                f"at least {terms + 1} runs",
                'Lower the degree, hyperbolic_norm or interaction, or use method="sparse".',
            )

    def fit(self, design: Design, values: np.ndarray, progress: Progress | None = None) -> ChaosExpansion:
        """Fit an expansion of one or many outputs.

        Parameters
        ----------
        design : Design
            Points, with their parameter space.
        values : array-like, shape (run,) or (run, output)
            Values of the function at these points.
        progress : callable, optional
            Callback whose arguments are the number of fitted outputs and the total number.

        Returns
        -------
        ChaosExpansion
            The fitted expansion.

        Raises
        ------
        InputError
            If a value is not finite, an output is constant, or there are too few runs for the basis.
        """
        theta, outputs = check_training("PCE.fit", design, values)
        if self.method == "shrinkage":
            expansion = _shrunk_expansion(design.space, theta, outputs)
            if progress is not None:
                progress(outputs.shape[1], outputs.shape[1])
            return expansion
        self.check_runs(design.space.dimension, len(theta))
        best: list[_Candidate | None] = [None] * outputs.shape[1]
        for norm in np.atleast_1d(self.hyperbolic_norm):
            self._search_degree(design.space, theta, outputs, float(norm), best, progress)
        candidates = [b for b in best if b is not None]
        return _expansion(design.space, candidates, theta, outputs)

    def _search_degree(
        self,
        space: ParameterSpace,
        theta: np.ndarray,
        outputs: np.ndarray,
        norm: float,
        best: list[_Candidate | None],
        progress: Progress | None,
    ) -> None:
        """Raise the degree until no output improves; keep the best model of each output in `best`."""
        waiting = {k: 0 for k in range(outputs.shape[1])}
        reached = dict.fromkeys(waiting, np.inf)
        for degree in sorted(int(d) for d in np.atleast_1d(self.degree)):
            if not waiting:
                break
            indices = multi_indices(space.dimension, degree, norm, self.interaction)
            if len(indices) > LARGEST_SEARCHED and all(b is not None for b in best):
                break  # keep the models found so far
            basis = PolynomialBasis(space, indices)
            columns = basis.evaluate(theta)
            if self.method == "ols" and len(basis) >= len(theta):
                break
            regression = None if self.method == "ols" else SparseRegression(columns, self.method)
            for k in list(waiting):
                fit = regression.fit(outputs[:, k]) if regression else _whole_basis_fit(columns, outputs[:, k])
                error = fit.leave_one_out_error
                best_so_far = best[k]
                if best_so_far is None or error < best_so_far.fit.leave_one_out_error:
                    best[k] = _Candidate(basis.indices[fit.active], fit, degree, norm)
                waiting[k] = 0 if error < reached[k] else waiting[k] + 1
                reached[k] = min(error, reached[k])
                if waiting[k] >= PATIENCE:
                    del waiting[k]
                if progress is not None:
                    progress(outputs.shape[1] - len(waiting), outputs.shape[1])


@dataclass(frozen=True, eq=False)
class _Candidate:
    """The best model of one output so far."""

    indices: np.ndarray
    fit: SparseFit
    degree: int
    norm: float


def _whole_basis_fit(columns: np.ndarray, response: np.ndarray) -> SparseFit:
    """Fit ordinary least squares on all columns."""
    fits = nested_least_squares(columns, response)
    error = float(fits.corrected[-1] / response.var())
    return SparseFit(np.arange(columns.shape[1]), least_squares(columns, response), error)


def _expansion(
    space: ParameterSpace, candidates: list[_Candidate], theta: np.ndarray, outputs: np.ndarray
) -> ChaosExpansion:
    """Write the models of all outputs in one basis, the union of their terms."""
    every = np.concatenate([f.indices for f in candidates])
    union, row_of_term = np.unique(every, axis=0, return_inverse=True)
    order = by_degree(union)
    rank = np.empty(len(union), dtype=int)
    rank[order] = np.arange(len(union))
    coefficients = np.zeros((len(union), len(candidates)))
    start = 0
    for k, candidate in enumerate(candidates):
        rows = rank[row_of_term.ravel()[start : start + len(candidate.indices)]]
        coefficients[rows, k] = candidate.fit.coefficients
        start += len(candidate.indices)
    return ChaosExpansion(
        PolynomialBasis(space, union[order]),
        coefficients,
        np.array([f.fit.leave_one_out_error for f in candidates]),
        tuple((f.degree, f.norm) for f in candidates),
        theta,
        outputs,
    )


def _shrunk_expansion(space: ParameterSpace, theta: np.ndarray, outputs: np.ndarray) -> ChaosExpansion:
    """Fit an expansion with more terms than runs, whose coefficients shrink with the degree."""
    fit = fit_shrunk(space, theta, outputs)
    truncation = ((int(fit.basis.indices.sum(axis=1).max()), 1.0),) * outputs.shape[1]
    return ChaosExpansion(fit.basis, fit.coefficients, fit.leave_one_out_error, truncation, theta, outputs)
