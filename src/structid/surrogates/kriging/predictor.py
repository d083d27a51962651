"""Kriging: Gaussian-process interpolation with a trend, one correlation for many outputs or one for each.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.linalg
import scipy.optimize
from scipy.stats import qmc

from structid.errors import InputError, check_choice
from structid.models.face import Progress
from structid.probability.space import Design, ParameterSpace
from structid.streams import Purpose, stream
from structid.surrogates.chaos.pce import PCE, check_training
from structid.surrogates.chaos.polynomials import PolynomialBasis, multi_indices, namespace
from structid.surrogates.kriging.correlations import FAMILIES, correlation
from structid.surrogates.named_arrays import found_under, put_under
from structid.surrogates.progress import Steps
from structid.surrogates.search import quasi_newton
from structid.surrogates.symmetric import inverse_of, raised_cholesky

PADDING = 64
"""Correlation matrices are computed for a multiple of so many points."""

LOG_LENGTHS = (-4.0, 7.0)
"""Range of the logarithm of a correlation length, in standard deviations of the design."""

LOG_NUGGETS = (-25.0, 0.0)
"""Range of the logarithm of an estimated nugget, relative to the process variance."""

LARGEST_RAISED_NUGGET = 1e-5
"""How far a nugget is raised where rounding makes the matrix indefinite; beyond, the points are too close to interpolate."""

SMALLEST_NUGGET = 1e-13
"""Added to the diagonal where no nugget is asked for, so that rounding does not make the matrix indefinite."""

SCREENING_POINTS = 250
"""Points of the design that the global search looks at."""


@dataclass(frozen=True)
class Kriging:
    """Settings of universal Kriging, f(θ) ≈ f(θ)ᵀβ + σ Z(θ) (thesis eq. 2.42, with σ for its σ²).

    Parameters
    ----------
    trend : {"constant", "linear", "quadratic"} or PCE
        The deterministic part; a `PCE` gives PC-Kriging (Schöbi, Sudret & Wiart 2015).
    correlation : {"matern52", "matern32", "exponential", "gaussian"}
        The correlation function.
    separable : bool, optional
        Product of one-dimensional correlations, or a function of an ellipsoidal distance; left out, both are fitted and the smaller
        leave-one-out error decides.
    nugget : float or "estimate"
        Variance of the noise relative to the process; 0 interpolates.
    estimation : {"ml", "cv"}
        Hyper-parameters by maximum likelihood or by leave-one-out cross-validation (thesis eq. 2.46).
    shared : bool
        One set of correlation lengths for all outputs, weighted as they are scaled, or a set for each.
    starts : int
        Gradient searches, from the best points of the global one.
    seed : int
        Seed of the global search.
    """

    trend: Literal["constant", "linear", "quadratic"] | PCE = "constant"
    correlation: Literal["exponential", "matern32", "matern52", "gaussian"] = "matern52"
    separable: bool | None = None
    nugget: float | Literal["estimate"] = 0.0
    estimation: Literal["ml", "cv"] = "ml"
    shared: bool = True
    starts: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.trend, PCE):
            check_choice("Kriging.trend", self.trend, ("constant", "linear", "quadratic"))
        check_choice("Kriging.correlation", self.correlation, FAMILIES)
        check_choice("Kriging.estimation", self.estimation, ("ml", "cv"))
        if self.nugget != "estimate" and not (isinstance(self.nugget, (int, float)) and 0 <= self.nugget < np.inf):
            raise InputError("Kriging.nugget", f"{self.nugget!r}", 'a number, 0 or more, or "estimate"')

    def fit(
        self,
        design: Design,
        values: np.ndarray,
        progress: Progress | None = None,
        start: KrigingPredictor | None = None,
    ) -> KrigingPredictor:
        """Fit one output or many.

        Parameters
        ----------
        design : Design
            Points, with the space they come from.
        values : array-like, shape (run,) or (run, output)
            The function's values there.
        progress : callable, optional
            Told how many steps of the search for correlation lengths are done.
        start : KrigingPredictor, optional
            One fitted to fewer points, from whose lengths the search starts: there is no global search then. It counts only where
            all outputs share their lengths.

        Returns
        -------
        KrigingPredictor
            Mean and standard deviation anywhere.

        Raises
        ------
        InputError
            If a value is not finite, an output constant, a point there twice without a nugget, or the runs are too few for
            the trend.
        """
        theta, outputs = check_training("Kriging.fit", design, values)
        if self.nugget == 0.0:
            _check_distinct(theta)
        groups = [np.arange(outputs.shape[1])] if self.shared else [np.array([k]) for k in range(outputs.shape[1])]
        known = start.groups[0] if start is not None and self.shared and len(start.groups) == 1 else None
        forms = len(groups) * len(self._forms(theta))
        tell = Steps(progress, forms * (1 if known else max(self.starts, 1) * len(_sizes(len(theta)))))
        fitted = [self._fit_group(design, theta, outputs[:, group], group, known, tell) for group in groups]
        return KrigingPredictor(design.space, tuple(fitted))

    def _forms(self, theta: np.ndarray) -> tuple[bool, ...]:
        """Whether the correlation is a product over the parameters: as asked for, or both ways, where they differ."""
        forms = (False, True) if self.separable is None else (self.separable,)
        return forms[:1] if self.correlation == "gaussian" or theta.shape[1] == 1 else forms

    def _fit_group(
        self,
        design: Design,
        theta: np.ndarray,
        outputs: np.ndarray,
        group: np.ndarray,
        known: KrigingGroup | None,
        tell: Steps,
    ) -> KrigingGroup:
        trend = self._trend_basis(design, outputs)
        if len(trend) >= len(theta):
            raise InputError(
                "Kriging.fit", f"{len(theta)} runs for a trend of {len(trend)} terms", f"{len(trend) + 1} runs or more"
            )
        candidates = [self._fit_form(theta, outputs, group, trend, form, known, tell) for form in self._forms(theta)]
        return min(candidates, key=lambda c: float(np.sum(c.leave_one_out_residuals**2)))

    def _trend_basis(self, design: Design, outputs: np.ndarray) -> PolynomialBasis:
        space = design.space
        if not isinstance(self.trend, PCE):
            degree = {"constant": 0, "linear": 1, "quadratic": 2}[self.trend]
            return PolynomialBasis(space, multi_indices(space.dimension, degree))
        expansion = self.trend.fit(design, outputs)
        # Of many outputs that share a trend the terms that carry most, and few enough to leave room for the process.
        energy = np.sum(expansion.coefficients**2, axis=1)
        most = max(1, min(len(energy), len(outputs) // 5))
        return expansion.basis[np.sort(np.argsort(-energy)[:most])]

    def _fit_form(
        self,
        theta: np.ndarray,
        outputs: np.ndarray,
        group: np.ndarray,
        trend: PolynomialBasis,
        separable: bool,
        known: KrigingGroup | None,
        tell: Steps,
    ) -> KrigingGroup:
        centre, scale = theta.mean(axis=0), theta.std(axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        data = _Data((theta - centre) / scale, trend.evaluate(theta), outputs)
        objective = _Objective(data, self.correlation, separable, self.nugget, self.estimation)
        if known is None:
            best = _search(objective, data, self.starts, stream(self.seed, Purpose.KRIGING_SEARCH), tell)
        else:
            nugget = [np.log(known.factors.nugget)] * (self.nugget == "estimate")
            best = _refined(objective, np.append(np.log(known.lengths / scale), nugget), tell)
        try:
            factors = _Factors.of(data, objective.matrix(best), objective.diagonal(best))
        except np.linalg.LinAlgError:
            raise InputError(
                "Kriging.fit", "points so close that they cannot be told apart", "points further apart, or a nugget",
                'Estimate one: nugget="estimate".',
            ) from None  # fmt: skip
        return KrigingGroup(
            self.correlation, separable, group, centre, scale, data.points, trend, best[: theta.shape[1]], factors
        )


def _check_distinct(theta: np.ndarray) -> None:
    _, first, count = np.unique(theta, axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        row = int(first[np.argmax(count > 1)])
        twin = np.flatnonzero((theta == theta[row]).all(axis=1))
        raise InputError(
            "Kriging.fit",
            f"{int((count - 1).sum())} points that are there twice, such as rows {twin[0]} and {twin[1]}",
            "distinct points",
            'Leave the copies out, or give a nugget (nugget="estimate").',
        )


@dataclass(frozen=True, eq=False)
class _Data:
    """Standardised points (run, parameter), trend terms there (run, term), outputs (run, output)."""

    points: np.ndarray
    trend: np.ndarray
    outputs: np.ndarray

    def some(self, rows: np.ndarray) -> _Data:
        return _Data(self.points[rows], self.trend[rows], self.outputs[rows])


@functools.cache
def _compiled(family: str, separable: bool) -> tuple[Any, Any, Any]:
    """Correlation matrix, the gradient of a weighted sum of its entries, and matrices for many lengths, over the devices."""
    import jax

    from structid.device import jnp, over_runs

    def columns(some: Any, points: Any, log_lengths: Any) -> Any:
        return correlation(family, separable, points, some, log_lengths)

    def matrices(log_lengths: Any, points: Any) -> Any:
        """Correlation matrices of the same points for many lengths."""
        return jax.vmap(lambda lengths: correlation(family, separable, points, points, lengths))(log_lengths)

    def gradients(rows: Any, points: Any) -> Any:
        """Of Σⱼ weightⱼ R(point, pointⱼ) by the log lengths; a row is log lengths, point, weights.

        The lengths come with each row: the gradient by something all devices share would be summed over them.
        """
        size = points.shape[1]

        def weighted(log_lengths: Any, row: Any) -> Any:
            return jnp.vdot(
                row[2 * size :], correlation(family, separable, row[None, size : 2 * size], points, log_lengths)
            )

        return jax.vmap(lambda row: jax.grad(weighted)(row[:size], row))(rows)

    return over_runs(columns, run_axes=1), over_runs(gradients), over_runs(matrices)


@dataclass(frozen=True, eq=False)
class _Factors:
    """What a correlation matrix C = R + nugget · I gives for a set of outputs.

    With A = C⁻¹F and T = (FᵀC⁻¹F)⁻¹: trend coefficients β = T Aᵀ y; weights w = C⁻¹(y − Fβ); and, since Q = C⁻¹ − A T Aᵀ,
    leave-one-out residuals eᵢ = (Qy)ᵢ/Qᵢᵢ with variances σ²/Qᵢᵢ (Dubrule 1983, doi 10.1007/BF01033232).
    """

    cholesky: np.ndarray
    nugget: float
    solved_trend: np.ndarray
    trend_covariance: np.ndarray
    coefficients: np.ndarray
    weights: np.ndarray
    leave_one_out_residuals: np.ndarray
    precision: np.ndarray
    likelihood_variance: np.ndarray

    @classmethod
    def of(cls, data: _Data, matrix: np.ndarray, nugget: float) -> _Factors:
        cholesky, nugget = _cholesky(matrix, nugget)
        solved_trend, trend_covariance, coefficients, weights = _generalised_least_squares(data, cholesky)
        inverse = inverse_of(cholesky)
        precision = np.diag(inverse) - np.einsum("ij,jk,ik->i", solved_trend, trend_covariance, solved_trend)
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
        """σ² that makes the standardised leave-one-out residuals of unit variance, shape (output,)."""
        return np.mean(self.leave_one_out_residuals**2 * self.precision[:, None], axis=0)


def _cholesky(matrix: np.ndarray, nugget: float) -> tuple[np.ndarray, float]:
    """Lower factor of matrix + nugget · I; what is asked for is raised where rounding demands it, within reason."""
    nugget = max(nugget, SMALLEST_NUGGET)
    return raised_cholesky(matrix, nugget, max(LARGEST_RAISED_NUGGET, 2.0 * nugget))


def _generalised_least_squares(
    data: _Data, cholesky: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A = C⁻¹F, T = (FᵀA)⁻¹, β = T Aᵀy, w = C⁻¹(y − Fβ)."""
    solved_trend = scipy.linalg.cho_solve((cholesky, True), data.trend)
    trend_covariance = np.linalg.inv(data.trend.T @ solved_trend)
    coefficients = trend_covariance @ (solved_trend.T @ data.outputs)
    weights = scipy.linalg.cho_solve((cholesky, True), data.outputs - data.trend @ coefficients)
    return solved_trend, trend_covariance, coefficients, weights


class _Objective:
    """What hyper-parameters are chosen by, and its exact gradient; all outputs share one variance.

    Maximum likelihood, profiled over β and σ²: N/2 log σ̂² + ½ log|C|, whose derivative by C is ½ (C⁻¹ − w wᵀ/σ̂²).
    Cross-validation: N/2 log Σ eᵢ², whose derivative by Q is M with M_ij = 2 eᵢ yⱼ/Qᵢᵢ − δ_ij 2 eᵢ²/Qᵢᵢ, and dQ = −Q dC Q.
    """

    def __init__(self, data: _Data, family: str, separable: bool, nugget: float | str, estimation: str) -> None:
        self.data, self.family, self.separable = data, family, separable
        self.nugget, self.estimation = nugget, estimation
        self.lengths = data.points.shape[1]

    def on(self, data: _Data) -> _Objective:
        """The same for other data."""
        return _Objective(data, self.family, self.separable, self.nugget, self.estimation)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        return [LOG_LENGTHS] * self.lengths + [LOG_NUGGETS] * (self.nugget == "estimate")

    def matrix(self, parameters: np.ndarray) -> np.ndarray:
        """Correlations of the points, shape (run, run)."""
        columns, _, _ = _compiled(self.family, self.separable)
        points = _padded(self.data.points)
        size = len(self.data.points)
        return np.asarray(columns(points, points, parameters[: self.lengths]))[:size, :size]

    def diagonal(self, parameters: np.ndarray) -> float:
        """The nugget."""
        return float(np.exp(parameters[-1])) if self.nugget == "estimate" else float(self.nugget)

    def values(self, parameters: np.ndarray) -> np.ndarray:
        """The objective alone at many places, (parameter, place) as differential evolution asks for them."""
        _, _, matrices = _compiled(self.family, self.separable)
        found = matrices(np.ascontiguousarray(parameters[: self.lengths].T), self.data.points)
        return np.array([self._given(matrix, p, False)[0] for matrix, p in zip(found, parameters.T, strict=True)])

    def __call__(self, parameters: np.ndarray, gradient: bool = True) -> tuple[float, np.ndarray]:
        """The objective and its gradient by the log lengths and the log nugget."""
        return self._given(self.matrix(parameters), parameters, gradient)

    def _given(self, matrix: np.ndarray, parameters: np.ndarray, gradient: bool) -> tuple[float, np.ndarray]:
        """The same with the correlation matrix known."""
        try:
            cholesky, nugget = _cholesky(matrix, self.diagonal(parameters))
            by_matrix = self._likelihood if self.estimation == "ml" else self._cross_validation
            value, weights = by_matrix(cholesky, gradient)
        except np.linalg.LinAlgError:
            return 1e25, np.zeros(len(parameters))
        if not gradient:
            return value, np.empty(0)
        _, gradients, _ = _compiled(self.family, self.separable)
        size, points = len(self.data.points), _padded(self.data.points)
        weights_of = np.zeros((len(points), len(points)))
        weights_of[:size, :size] = weights  # what is padded has no weight
        rows = np.hstack([np.tile(parameters[: self.lengths], (len(points), 1)), points, weights_of])
        slope = gradients(rows, points).sum(axis=0)
        if self.nugget == "estimate":
            slope = np.append(slope, nugget * np.trace(weights))
        return value, slope

    def _likelihood(self, cholesky: np.ndarray, gradient: bool) -> tuple[float, np.ndarray]:
        runs, outputs = self.data.outputs.shape
        _, _, coefficients, weights = _generalised_least_squares(self.data, cholesky)
        error = self.data.outputs - self.data.trend @ coefficients
        variance = float(np.sum(error * weights)) / (runs * outputs)
        value = 0.5 * runs * np.log(variance) + np.sum(np.log(np.diag(cholesky)))
        if not gradient:
            return float(value), np.empty(0)
        return float(value), 0.5 * (inverse_of(cholesky) - weights @ weights.T / (variance * outputs))

    def _cross_validation(self, cholesky: np.ndarray, gradient: bool) -> tuple[float, np.ndarray]:
        solved_trend, trend_covariance, _, weights = _generalised_least_squares(self.data, cholesky)
        q = inverse_of(cholesky) - solved_trend @ trend_covariance @ solved_trend.T
        precision = np.diag(q)
        error = weights / precision[:, None]
        total = float(np.sum(error**2))
        value = 0.5 * len(q) * np.log(total)
        if not gradient:
            return float(value), np.empty(0)
        by_inverse = q @ (2.0 * error / precision[:, None]) @ weights.T
        by_inverse -= (q * (2.0 * np.sum(error**2, axis=1) / precision)) @ q
        return float(value), -0.5 * len(q) / total * by_inverse


def _sizes(runs: int) -> list[int]:
    """Runs that each stage of the search sees: all of them at last, half as many in the stage before, and so on."""
    sizes = [runs]
    while sizes[-1] > 2 * SCREENING_POINTS:
        sizes.append(sizes[-1] // 2)
    return sizes[::-1]


def _search(objective: _Objective, data: _Data, starts: int, rng: np.random.Generator, tell: Steps) -> np.ndarray:
    """Differential evolution on part of the design, then quasi-Newton steps on that part, on twice as much, … on all of it.

    The curvature found on one part, scaled by the number of runs, starts the next, so that few evaluations see the whole design.
    """
    order = rng.permutation(len(data.points))
    parts = _sizes(len(data.points))[:-1]
    stages = [objective.on(data.some(np.sort(order[:size]))) for size in parts] + [objective]
    screening = objective.on(data.some(np.sort(order[:SCREENING_POINTS])))
    bounds = objective.bounds
    found = scipy.optimize.differential_evolution(
        screening.values, bounds, init=_spread(bounds, 8 * len(bounds), rng), maxiter=12, polish=False, rng=rng,
        vectorized=True, updating="deferred",
    )  # fmt: skip
    best, lowest = found.x, np.inf
    for start in found.population[np.argsort(found.population_energies)[: max(starts, 1)]]:
        place = scipy.optimize.minimize(screening, start, jac=True, method="L-BFGS-B", bounds=bounds).x
        covariance = _inverse_curvature(screening, place)
        runs = len(screening.data.points)
        for stage in stages:
            covariance = covariance * (runs / len(stage.data.points))
            place, covariance, value = quasi_newton(stage, stage.bounds, place, covariance)
            runs = len(stage.data.points)
            tell()
        if value < lowest:
            best, lowest = place, value
    return np.asarray(best)


def _refined(objective: _Objective, start: np.ndarray, tell: Steps) -> np.ndarray:
    """Quasi-Newton steps on the whole design from a place that is near already."""
    place = np.clip(start, *np.array(objective.bounds).T)
    place, _, _ = quasi_newton(objective, objective.bounds, place, _inverse_curvature(objective, place))
    tell()
    return place


def _padded(points: np.ndarray) -> np.ndarray:
    """Points and copies of the last one, up to a multiple of `PADDING`: designs that grow are compiled for seldom."""
    missing = -len(points) % PADDING
    return np.concatenate([points, np.repeat(points[-1:], missing, axis=0)]) if missing else points


def _inverse_curvature(objective: _Objective, place: np.ndarray) -> np.ndarray:
    """Inverse of the matrix of second derivatives, by differences of gradients; flat directions are made finite."""
    step = 1e-3
    slopes = [
        (objective(place + step * e)[1] - objective(place - step * e)[1]) / (2 * step) for e in np.eye(len(place))
    ]
    values, vectors = np.linalg.eigh(0.5 * (np.array(slopes) + np.array(slopes).T))
    return np.asarray((vectors / np.maximum(values, 1.0)) @ vectors.T)


def _spread(bounds: list[tuple[float, float]], count: int, rng: np.random.Generator) -> np.ndarray:
    """First generation of the search: spread evenly, from about the distance of neighbours upwards."""
    low, high = np.array(bounds).T
    return low + (high - low) * qmc.LatinHypercube(len(bounds), rng=rng).random(count)


@dataclass(frozen=True, eq=False)
class KrigingGroup:
    """Outputs that share one correlation.

    Parameters
    ----------
    family : str
        The correlation function.
    separable : bool
        Its form.
    outputs : ndarray of int, shape (output,)
        Which outputs these are.
    centre, scale : ndarray, shape (parameter,)
        Mean and standard deviation of the design: points are standardised by them.
    points : ndarray, shape (run, parameter)
        The standardised design.
    trend : PolynomialBasis
        Terms of the trend.
    log_lengths : ndarray, shape (parameter,)
        Logarithms of the correlation lengths, in standard deviations of the design.
    factors : object
        Cholesky factor and what follows from it.
    """

    family: str
    separable: bool
    outputs: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    points: np.ndarray
    trend: PolynomialBasis
    log_lengths: np.ndarray
    factors: _Factors

    @property
    def lengths(self) -> np.ndarray:
        """Correlation lengths in SI, shape (parameter,)."""
        return np.exp(self.log_lengths) * self.scale

    @property
    def leave_one_out_residuals(self) -> np.ndarray:
        """Observed minus predicted from all other runs, shape (run, output)."""
        return self.factors.leave_one_out_residuals

    @property
    def variance(self) -> np.ndarray:
        """Process variance σ² of each output, from the standardised leave-one-out residuals, shape (output,)."""
        return self.factors.cross_validated_variance

    def mean(self, theta: Any) -> Any:
        """Predicted mean inside JAX, f(θ)ᵀβ + r(θ)ᵀw.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        jax.Array, shape (run, output)
            Means.
        """
        return self.trend.evaluate(theta) @ self.factors.coefficients + self._correlations(theta) @ self.factors.weights

    def standard_deviation(self, theta: Any) -> Any:
        """Predicted standard deviation inside JAX, s² = σ²(1 − rᵀC⁻¹r + uᵀTu), u = Fᵀ C⁻¹ r − f.

        Parameters
        ----------
        theta : jax.Array, shape (run, parameter)
            Points in SI.

        Returns
        -------
        jax.Array, shape (run, output)
            Standard deviations of the noise-free function.
        """
        import jax.scipy.linalg as linalg

        from structid.device import jnp

        r = self._correlations(theta)
        whitened = linalg.solve_triangular(jnp.asarray(self.factors.cholesky), r.T, lower=True)
        u = r @ self.factors.solved_trend - self.trend.evaluate(theta)
        share = 1.0 - jnp.sum(whitened**2, axis=0) + jnp.einsum("rj,jk,rk->r", u, self.factors.trend_covariance, u)
        return jnp.sqrt(jnp.maximum(share, 0.0))[:, None] * jnp.sqrt(self.variance)

    def _correlations(self, theta: Any) -> Any:
        from structid.device import jnp

        points = (theta - self.centre) / self.scale
        return correlation(self.family, self.separable, points, jnp.asarray(self.points), jnp.asarray(self.log_lengths))


@dataclass(frozen=True, eq=False)
class KrigingPredictor:
    """A fitted Kriging of one output or many.

    Parameters
    ----------
    space : ParameterSpace
        The parameters.
    groups : tuple of KrigingGroup
        Outputs that share a correlation, together all of them.
    """

    space: ParameterSpace
    groups: tuple[KrigingGroup, ...]

    @cached_property
    def _order(self) -> np.ndarray:
        return np.argsort(np.concatenate([g.outputs for g in self.groups]))

    @property
    def leave_one_out_residuals(self) -> np.ndarray:
        """Observed minus predicted from all other runs, shape (run, output)."""
        return np.hstack([g.leave_one_out_residuals for g in self.groups])[:, self._order]

    @property
    def leave_one_out_error(self) -> np.ndarray:
        """Mean squared leave-one-out residual relative to the variance of the output, shape (output,) (thesis eq. 2.47)."""
        parts = []
        for group in self.groups:
            # The output is what the trend and the weights reproduce: y = Fβ + C w.
            trend = group.trend.evaluate(group.points * group.scale + group.centre) @ group.factors.coefficients
            lower = group.factors.cholesky
            outputs = trend + lower @ (lower.T @ group.factors.weights)
            parts.append(np.mean(group.leave_one_out_residuals**2, axis=0) / outputs.var(axis=0))
        return np.concatenate(parts)[self._order]

    def predict(self, theta: Any, return_std: bool = False) -> Any:
        """Predict the outputs at other points.

        Parameters
        ----------
        theta : ndarray or jax.Array, shape (run, parameter)
            Points in SI.
        return_std : bool
            Also give the standard deviations.

        Returns
        -------
        array or tuple of array, shape (run, output)
            Means, or means and standard deviations; of the kind `theta` is.
        """
        if namespace(theta) is np:
            compiled = self._with_std if return_std else self._without_std
            return compiled(theta)
        mean = self._join([g.mean(theta) for g in self.groups])
        return (mean, self._join([g.standard_deviation(theta) for g in self.groups])) if return_std else mean

    def _join(self, parts: list[Any]) -> Any:
        from structid.device import jnp

        return parts[0] if len(parts) == 1 else jnp.concatenate(parts, axis=1)[:, self._order]

    @cached_property
    def _without_std(self) -> Any:
        return _in_batches(lambda theta: self.predict(theta))

    @cached_property
    def _with_std(self) -> Any:
        return _in_batches(lambda theta: self.predict(theta, return_std=True))

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Give what the predictor consists of beside its space, for a file.

        Returns
        -------
        tuple of dict
            What JSON can say, and arrays.
        """
        plain: dict[str, Any] = {}
        arrays: dict[str, np.ndarray] = {}
        for number, group in enumerate(self.groups):
            plain[str(number)] = {"family": group.family, "separable": group.separable, "nugget": group.factors.nugget}
            own = {name: getattr(group, name) for name in _GROUP_ARRAYS}
            own |= {name: getattr(group.factors, name) for name in _FACTOR_ARRAYS}
            arrays |= put_under(str(number), {**own, "trend": group.trend.indices})
        return plain, arrays

    @classmethod
    def from_plain(
        cls, space: ParameterSpace, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> KrigingPredictor:
        """Make a predictor again from what `to_plain` said.

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
        KrigingPredictor
            The same predictor.
        """
        groups = []
        for number, said in plain.items():
            own = found_under(number, arrays)
            factors = _Factors(nugget=said["nugget"], **{name: own[name] for name in _FACTOR_ARRAYS})
            groups.append(
                KrigingGroup(
                    said["family"],
                    said["separable"],
                    trend=PolynomialBasis(space, own["trend"]),
                    factors=factors,
                    **{name: own[name] for name in _GROUP_ARRAYS},
                )
            )
        return cls(space, tuple(groups))

    def __str__(self) -> str:
        group = self.groups[0]
        form = "separable" if group.separable else "ellipsoidal"
        lengths = ", ".join(f"{n} {v:.3g}" for n, v in zip(self.space.names, np.exp(group.log_lengths), strict=True))
        return (
            f"Kriging of {len(group.points)} runs, {len(self._order)} outputs: {form} {group.family} correlation, "
            f"trend of {len(group.trend)} terms, nugget {group.factors.nugget:.1e}, "
            f"leave-one-out error up to {self.leave_one_out_error.max():.1e}; "
            f"lengths in standard deviations of the design: {lengths}"
        )


_GROUP_ARRAYS = ("outputs", "centre", "scale", "points", "log_lengths")
_FACTOR_ARRAYS = tuple(f.name for f in dataclasses.fields(_Factors) if f.name != "nugget")

PREDICTION_BATCH = 4096
"""Points predicted at once: correlations with every run are kept for each."""


def _in_batches(function: Any) -> Any:
    import jax

    from structid.device import over_runs

    compiled = over_runs(function)

    def call(theta: np.ndarray) -> Any:
        theta = np.asarray(theta, dtype=np.float64)
        size = PREDICTION_BATCH
        parts = [compiled(theta[start : start + size]) for start in range(0, len(theta), size)]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)

    return call
