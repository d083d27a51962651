"""Polynomial chaos: functions of the uncertain parameters as sums of polynomials orthonormal under their prior.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from structid.errors import InputError, check_choice
from structid.models.face import Progress
from structid.probability.space import Design, ParameterSpace
from structid.streams import Purpose, stream
from structid.surrogates.chaos.lars import SparseFit, SparseRegression, least_squares, nested_least_squares
from structid.surrogates.chaos.polynomials import PolynomialBasis, by_degree, check_points, multi_indices
from structid.surrogates.chaos.shrinkage import fit_shrunk

PATIENCE = 2
"""Degrees without a better leave-one-out error after which a degree-adaptive fit stops."""


LARGEST_SEARCHED = 6000
"""Terms beyond which a search for the degree ends, if it has found something; a single degree that is asked for may have more."""

METHODS = ("sparse", "lars", "forward", "ols", "shrinkage")
"""Ways to find the coefficients."""


@dataclass(frozen=True)
class PCE:
    """Settings of a polynomial chaos expansion, f(θ) ≈ Σ_α c_α Ψ_α(θ) (thesis eq. 2.34).

    Parameters
    ----------
    degree : int or sequence of int
        Largest total degree; of several each output takes the one with the smallest leave-one-out error, and the search stops
        early when that no longer falls.
    hyperbolic_norm : float or sequence of float
        q of the hyperbolic truncation, in (0, 1]; likewise.
    interaction : int, optional
        Most parameters in one term.
    method : {"sparse", "lars", "forward", "ols", "shrinkage"}
        How terms are chosen: by least angle regression, by forward orthogonal least squares, by whichever of the two has clearly
        the smaller leave-one-out error, or not at all: ordinary least squares on the whole basis. ``"shrinkage"`` keeps many more
        terms than there are runs and lets their coefficients fall with the degree, at rates all outputs share and that are
        learnt; degree, norm and interaction are not used then.
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
        """Check that there are runs enough for the smallest basis; ordinary least squares needs more of them than terms.

        Parameters
        ----------
        dimension : int
            Number of parameters.
        runs : int
            How many there are, or will be.

        Raises
        ------
        InputError
            If there are too few.
        """
        if self.method != "ols":
            return
        norm = float(np.min(self.hyperbolic_norm))
        terms = len(multi_indices(dimension, int(np.min(self.degree)), norm, self.interaction))
        if terms >= runs:
            raise InputError(
                "PCE.fit",
                f"{runs} runs for a basis of {terms} terms",
                f"{terms + 1} runs or more",
                'Lower the degree, hyperbolic_norm or interaction, or choose method="sparse".',
            )

    def fit(self, design: Design, values: np.ndarray, progress: Progress | None = None) -> ChaosExpansion:
        """Fit one expansion or many.

        Parameters
        ----------
        design : Design
            Points, with the space they come from.
        values : array-like, shape (run,) or (run, output)
            The function's values there.
        progress : callable, optional
            Told how many outputs are fitted.

        Returns
        -------
        ChaosExpansion
            The fitted expansion.

        Raises
        ------
        InputError
            If a value is not finite, an output constant, or the runs are too few for the basis.
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
        found = [b for b in best if b is not None]
        return _expansion(design.space, found, theta, outputs)

    def _search_degree(
        self,
        space: ParameterSpace,
        theta: np.ndarray,
        outputs: np.ndarray,
        norm: float,
        best: list[_Candidate | None],
        progress: Progress | None,
    ) -> None:
        """Raise the degree until no output gains by it; keep each output's best model in `best`."""
        waiting = {k: 0 for k in range(outputs.shape[1])}
        reached = dict.fromkeys(waiting, np.inf)
        for degree in sorted(int(d) for d in np.atleast_1d(self.degree)):
            if not waiting:
                break
            indices = multi_indices(space.dimension, degree, norm, self.interaction)
            if len(indices) > LARGEST_SEARCHED and all(b is not None for b in best):
                break  # what has been found is kept
            basis = PolynomialBasis(space, indices)
            columns = basis.evaluate(theta)
            if self.method == "ols" and len(basis) >= len(theta):
                break
            regression = None if self.method == "ols" else SparseRegression(columns, self.method)
            for k in list(waiting):
                fit = regression.fit(outputs[:, k]) if regression else _whole(columns, outputs[:, k])
                error = fit.leave_one_out_error
                known = best[k]
                if known is None or error < known.fit.leave_one_out_error:
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


def _whole(columns: np.ndarray, response: np.ndarray) -> SparseFit:
    fits = nested_least_squares(columns, response)
    error = float(fits.corrected[-1] / response.var())
    return SparseFit(np.arange(columns.shape[1]), least_squares(columns, response), error)


def check_training(where: str, design: Design, values: Any) -> tuple[np.ndarray, np.ndarray]:
    """Check what a surrogate of scalar outputs is fitted to.

    Parameters
    ----------
    where : str
        The function, for messages.
    design : Design
        Points.
    values : array-like, shape (run,) or (run, output)
        Outputs.

    Returns
    -------
    tuple of ndarray
        Points (run, parameter) and outputs (run, output).

    Raises
    ------
    InputError
        If the numbers do not match, a value is not finite, or an output does not vary.
    """
    if not isinstance(design, Design):
        raise InputError(
            where, f"a {type(design).__name__}", "a Design: points with their space",
            "space.sample(500, seed=1) makes one, Design(points, space) another.",
        )  # fmt: skip
    theta = check_points(where, design.values, design.space.dimension, design.names)
    outputs = np.asarray(values, dtype=np.float64)
    outputs = outputs[:, None] if outputs.ndim == 1 else outputs
    if outputs.ndim != 2 or len(outputs) != len(theta):
        raise InputError(
            where, f"values of shape {np.shape(values)} for {len(theta)} points", f"({len(theta)}, output)"
        )
    bad = np.flatnonzero(~np.isfinite(outputs).all(axis=1))
    if len(bad):
        raise InputError(
            where, f"{len(bad)} rows that are not finite, the first of them row {bad[0]}", "finite numbers",
            "Leave failed runs out.",
        )  # fmt: skip
    if len(theta) < 3:
        raise InputError(where, f"{len(theta)} runs", "3 or more")
    spread = np.ptp(outputs, axis=0)
    constant = np.flatnonzero(spread <= 1e-14 * np.abs(outputs).max(axis=0))
    if len(constant):
        raise InputError(
            where, f"output {constant[0]}, which is {outputs[0, constant[0]]:g} in every run", "outputs that vary",
            "Leave it out: there is nothing to fit.",
        )  # fmt: skip
    return theta, outputs


def _expansion(
    space: ParameterSpace, found: list[_Candidate], theta: np.ndarray, outputs: np.ndarray
) -> ChaosExpansion:
    """Bring the models of all outputs into one basis: the union of their terms."""
    every = np.concatenate([f.indices for f in found])
    union, place = np.unique(every, axis=0, return_inverse=True)
    order = by_degree(union)
    rank = np.empty(len(union), dtype=int)
    rank[order] = np.arange(len(union))
    coefficients = np.zeros((len(union), len(found)))
    start = 0
    for k, candidate in enumerate(found):
        rows = rank[place.ravel()[start : start + len(candidate.indices)]]
        coefficients[rows, k] = candidate.fit.coefficients
        start += len(candidate.indices)
    return ChaosExpansion(
        PolynomialBasis(space, union[order]),
        coefficients,
        np.array([f.fit.leave_one_out_error for f in found]),
        tuple((f.degree, f.norm) for f in found),
        theta,
        outputs,
    )


def _shrunk_expansion(space: ParameterSpace, theta: np.ndarray, outputs: np.ndarray) -> ChaosExpansion:
    fit = fit_shrunk(space, theta, outputs)
    truncation = ((int(fit.basis.indices.sum(axis=1).max()), 1.0),) * outputs.shape[1]
    return ChaosExpansion(fit.basis, fit.coefficients, fit.leave_one_out_error, truncation, theta, outputs)


@dataclass(frozen=True, eq=False)
class ChaosExpansion:
    """A fitted polynomial chaos expansion of one output or many.

    Parameters
    ----------
    basis : PolynomialBasis
        Every term some output uses.
    coefficients : ndarray, shape (term, output)
        Zero where an output does not use a term.
    leave_one_out_error : ndarray, shape (output,)
        Corrected leave-one-out error relative to the output's variance.
    truncation : tuple of tuple
        Degree and hyperbolic norm chosen for each output.
    theta : ndarray, shape (run, parameter)
        The points it was fitted to.
    outputs : ndarray, shape (run, output)
        The values there.
    """

    basis: PolynomialBasis
    coefficients: np.ndarray
    leave_one_out_error: np.ndarray
    truncation: tuple[tuple[int, float], ...]
    theta: np.ndarray
    outputs: np.ndarray

    @property
    def terms(self) -> np.ndarray:
        """How many terms each output uses, shape (output,)."""
        return np.count_nonzero(self.coefficients, axis=0)

    @property
    def mean(self) -> np.ndarray:
        """Mean of each output under the prior: the coefficient of the constant, shape (output,)."""
        return self.prior_coefficients[self._constant].sum(axis=0)

    @cached_property
    def prior_coefficients(self) -> np.ndarray:
        """Coefficients of the polynomials orthonormal under the prior, which moments and indices are made of, (term, output)."""
        return self.basis.to_prior(self.coefficients)

    @property
    def variance(self) -> np.ndarray:
        """Variance of each output under the prior, Σ_{α≠0} c_α², shape (output,)."""
        return np.sum(self.prior_coefficients[~self._constant] ** 2, axis=0)

    @property
    def _constant(self) -> np.ndarray:
        return np.asarray(~self.basis.indices.any(axis=1))

    def predict(self, theta: Any) -> Any:
        """Values at other points.

        Parameters
        ----------
        theta : ndarray or jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        array, shape (run, output)
            Of the kind `theta` is.
        """
        return self.basis.evaluate(theta) @ self.coefficients

    def sobol_indices(self, order: int | Literal["total"] = 1) -> np.ndarray:
        """Sobol' indices, shares of the variance (Sudret 2008, doi 10.1016/j.ress.2007.04.002).

        Parameters
        ----------
        order : {1, 2, "total"}
            First order, second order (pairs), or total.

        Returns
        -------
        ndarray, shape (parameter, output), or (parameter, parameter, output) for pairs
            Sᵢ, S_T,ᵢ or Sᵢⱼ; the diagonal of the pairs is zero.

        Raises
        ------
        InputError
            If the parameters are dependent: their variance has no such shares.
        """
        if order not in (1, 2, "total"):
            raise InputError("sobol_indices: order", f"{order!r}", '1, 2 or "total"')
        if self.basis.space.correlation is not None:
            raise InputError("sobol_indices", "correlated parameters", "independent ones", "Sobol' indices need that.")
        used = self.basis.indices > 0
        share = self.prior_coefficients**2 / self.variance
        count = used.sum(axis=1)
        if order == 2:
            pairs = used[count == 2].astype(float)
            indices = np.einsum("ti,tj,to->ijo", pairs, pairs, share[count == 2])
            indices[np.arange(used.shape[1]), np.arange(used.shape[1])] = 0.0
            return indices
        keep = used & (count == 1)[:, None] if order == 1 else used
        return keep.T.astype(float) @ share

    def bootstrap(self, replicates: int, seed: int) -> np.ndarray:
        """Coefficients refitted to runs drawn with replacement (Efron 1979), terms as chosen.

        Parameters
        ----------
        replicates : int
            How many.
        seed : int
            Seed.

        Returns
        -------
        ndarray, shape (replicate, term, output)
            Coefficients; their spread says how well the runs determine them.
        """
        if self.basis.box is not None:
            raise InputError(
                "bootstrap", "an expansion whose coefficients shrink with the degree", "one of the other methods",
                "Its terms are more than the runs: least squares does not determine them.",
            )  # fmt: skip
        rng = stream(seed, Purpose.BOOTSTRAP)
        columns = self.basis.evaluate(self.theta)
        found = np.zeros((replicates, *self.coefficients.shape))
        for r in range(replicates):
            rows = rng.integers(len(columns), size=len(columns))
            for k in range(self.coefficients.shape[1]):
                active = np.flatnonzero(self.coefficients[:, k])
                found[r, active, k] = np.linalg.lstsq(columns[np.ix_(rows, active)], self.outputs[rows, k], rcond=None)[
                    0
                ]
        return found

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Give what the expansion consists of beside its space, for a file.

        Returns
        -------
        tuple of dict
            What JSON can say, and arrays.
        """
        arrays = {
            "indices": self.basis.indices,
            **({} if self.basis.box is None else {"box": self.basis.box}),
            "coefficients": self.coefficients,
            "leave_one_out_error": self.leave_one_out_error,
            "truncation": np.array(self.truncation, dtype=np.float64),
            "theta": self.theta,
            "outputs": self.outputs,
        }
        return {}, arrays

    @classmethod
    def from_plain(
        cls, space: ParameterSpace, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> ChaosExpansion:
        """Make an expansion again from what `to_plain` said.

        Parameters
        ----------
        space : ParameterSpace
            The parameters.
        plain : dict
            What JSON can say.
        arrays : mapping of str to ndarray
            The arrays.

        Returns
        -------
        ChaosExpansion
            The same expansion.
        """
        return cls(
            PolynomialBasis(space, arrays["indices"], arrays.get("box")),
            arrays["coefficients"],
            arrays["leave_one_out_error"],
            tuple((int(d), float(q)) for d, q in arrays["truncation"]),
            arrays["theta"],
            arrays["outputs"],
        )

    def __str__(self) -> str:
        degrees = sorted({d for d, _ in self.truncation})
        return (
            f"polynomial chaos of {self.basis.space.dimension} parameters, {self.coefficients.shape[1]} outputs: "
            f"{len(self.basis)} terms, degrees {degrees[0]} to {degrees[-1]}, "
            f"leave-one-out error up to {self.leave_one_out_error.max():.1e}"
        )
