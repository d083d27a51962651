"""A fitted Kriging: mean, standard deviation and leave-one-out errors of one or many outputs.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import jax
import jax.scipy.linalg
import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from structid.core.arrays import Array
from structid.engine.array_module import namespace
from structid.engine.device import jnp
from structid.engine.matrices.row_by_row import product, product_of
from structid.probability.space import ParameterSpace
from structid.surrogates.chaos.polynomial_basis import PolynomialBasis
from structid.surrogates.kriging.correlation_matrices import CorrelationMatrices
from structid.surrogates.kriging.correlations import correlation
from structid.surrogates.kriging.kriging_system import SMALLEST_NUGGET, KrigingFactors
from structid.surrogates.named_arrays import found_under, put_under

PREDICTION_BATCH = 4096
"""Number of points predicted at once; their correlations with every run are in memory."""

_GROUP_ARRAYS = ("outputs", "centre", "scale", "points", "log_lengths")

_FACTOR_ARRAYS = tuple(f.name for f in dataclasses.fields(KrigingFactors) if f.name != "nugget")


@dataclass(frozen=True, eq=False)
class KrigingGroup:
    """A fitted Kriging predictor for outputs that share one correlation function."""

    family: str  # Name of the correlation function
    separable: bool  # Whether the correlation is a product over the parameters
    outputs: Int[np.ndarray, " output"]  # Positions of these outputs among all outputs
    # Mean of the design, subtracted to standardise points
    centre: Float[np.ndarray, " parameter"]
    # Standard deviation of the design, by which points are divided to standardise them
    scale: Float[np.ndarray, " parameter"]
    points: Float[np.ndarray, "run parameter"]  # The standardised design
    trend: PolynomialBasis  # The terms of the trend
    # Logarithms of the correlation lengths, in standard deviations of the design
    log_lengths: Float[np.ndarray, " parameter"]
    factors: KrigingFactors  # The solved Kriging system

    @property
    def lengths(self) -> np.ndarray:
        """Correlation lengths in SI, shape (parameter,)."""
        return np.asarray(np.exp(self.log_lengths) * self.scale)

    @property
    def leave_one_out_residuals(self) -> np.ndarray:
        """Observed output minus its prediction from all other runs, shape (run, output)."""
        return self.factors.leave_one_out_residuals

    @property
    def variance(self) -> np.ndarray:
        """Process variance σ² of each output, from the standardised leave-one-out residuals, shape (output,)."""
        return self.factors.cross_validated_variance

    def mean(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run output"]:
        """Predict the mean, f(θ)ᵀβ + r(θ)ᵀw."""
        if namespace(theta) is np:
            return self._mean(self.trend.evaluate(theta), self._correlations(theta))
        trend = product(self.trend.evaluate(theta), self.factors.coefficients)
        points, log_lengths = (theta - self.centre) / self.scale, jnp.asarray(self.log_lengths)

        def correlations(design: Any) -> Any:
            return correlation(self.family, self.separable, points, design, log_lengths)

        return trend + product_of(correlations, jnp.asarray(self.points), jnp.asarray(self.factors.weights))

    def _mean(self, f: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Return the mean on the host, from the trend terms and the correlations with every run."""
        return np.asarray(f @ self.factors.coefficients + r @ self.factors.weights)

    def mean_and_deviation(self, theta: Float[Array, "run parameter"]) -> tuple[Any, Any]:
        """Predict the mean and the standard deviation, s² = σ²(1 − rᵀC⁻¹r + uᵀTu), u = Fᵀ C⁻¹ r − f.

        The factor of σ² is accurate only to `SMALLEST_NUGGET`, which is therefore its smallest value. If runs are noisy
        and no nugget is given, σ² is so large that the smallest s² equals the variance of the noise.
        """
        numpy, f, r = namespace(theta), self.trend.evaluate(theta), self._correlations(theta)
        linalg = scipy.linalg if numpy is np else jax.scipy.linalg
        whitened = linalg.solve_triangular(numpy.asarray(self.factors.cholesky), r.T, lower=True)
        u = r @ self.factors.solved_trend - f
        share = 1.0 - (whitened**2).sum(axis=0) + numpy.einsum("rj,jk,rk->r", u, self.factors.trend_covariance, u)
        deviation = numpy.sqrt(numpy.maximum(share, SMALLEST_NUGGET))[:, None] * numpy.sqrt(self.variance)
        return (self._mean(f, r) if numpy is np else self.mean(theta)), deviation

    def _correlations(self, theta: Any) -> Any:
        """Return the correlations with every training run, shape (run, training run)."""
        points = (theta - self.centre) / self.scale
        if namespace(theta) is np:
            return self._on_the_host.with_points(points, self.log_lengths).T
        return correlation(self.family, self.separable, points, jnp.asarray(self.points), jnp.asarray(self.log_lengths))

    @cached_property
    def _on_the_host(self) -> CorrelationMatrices:
        return CorrelationMatrices(self.family, self.separable, self.points)


@dataclass(frozen=True, eq=False)
class KrigingPredictor:
    """A fitted Kriging of one or many outputs."""

    word: ClassVar[str] = "KrigingPredictor"
    space: ParameterSpace  # The parameters
    groups: tuple[KrigingGroup, ...]  # Groups of outputs with a common correlation; together they contain all outputs

    @cached_property
    def _order(self) -> np.ndarray:
        """Position of each output among the concatenated outputs of all groups."""
        return np.argsort(np.concatenate([g.outputs for g in self.groups]))

    @property
    def leave_one_out_residuals(self) -> np.ndarray:
        """Observed output minus its prediction from all other runs, shape (run, output)."""
        return np.hstack([g.leave_one_out_residuals for g in self.groups])[:, self._order]

    @property
    def leave_one_out_error(self) -> np.ndarray:
        """Mean squared leave-one-out residual relative to the variance of the output, shape (output,) (thesis eq. 2.47)."""
        parts = []
        for group in self.groups:
            # Trend and weights reproduce the outputs: y = Fβ + C w.
            trend = group.trend.evaluate(group.points * group.scale + group.centre) @ group.factors.coefficients
            lower = group.factors.cholesky
            outputs = trend + lower @ (lower.T @ group.factors.weights)
            parts.append(np.mean(group.leave_one_out_residuals**2, axis=0) / outputs.var(axis=0))
        return np.asarray(np.concatenate(parts)[self._order])

    def predict(self, theta: Float[Array, "run parameter"], return_std: bool = False) -> Any:
        """Predict the outputs at other points."""
        if namespace(theta) is np and len(theta) > PREDICTION_BATCH:
            starts = range(0, len(theta), PREDICTION_BATCH)
            parts = [self.predict(theta[first : first + PREDICTION_BATCH], return_std) for first in starts]
            return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
        if not return_std:
            return self._join([g.mean(theta) for g in self.groups])
        means, deviations = zip(*(g.mean_and_deviation(theta) for g in self.groups), strict=True)
        return self._join(list(means)), self._join(list(deviations))

    def deviation(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run output"]:
        """Predict the standard deviations; see `Regression.deviation`."""
        return self.predict_with_deviation(theta)[1]

    def predict_with_deviation(self, theta: Float[Array, "run parameter"]) -> tuple[Any, Any]:
        """Predict the outputs and their standard deviations; see `Regression.predict_with_deviation`."""
        mean, deviation = self.predict(theta, return_std=True)
        return mean, deviation

    def _join(self, parts: list[Any]) -> Any:
        """Join the outputs of all groups, in the original order of the outputs."""
        return parts[0] if len(parts) == 1 else namespace(parts[0]).concatenate(parts, axis=1)[:, self._order]

    def to_plain(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the contents of the predictor, without its parameter space, for a file."""
        plain: dict[str, Any] = {}
        arrays: dict[str, np.ndarray] = {}
        for number, group in enumerate(self.groups):
            plain[str(number)] = {"family": group.family, "separable": group.separable, "nugget": group.factors.nugget}
            arrays_of_group = {name: getattr(group, name) for name in _GROUP_ARRAYS}
            arrays_of_group |= {name: getattr(group.factors, name) for name in _FACTOR_ARRAYS}
            arrays |= put_under(str(number), {**arrays_of_group, "trend": group.trend.indices})
        return plain, arrays

    @classmethod
    def from_plain(
        cls, space: ParameterSpace, plain: dict[str, Any], arrays: Mapping[str, np.ndarray]
    ) -> KrigingPredictor:
        """Rebuild a predictor from the result of `to_plain`."""
        groups = []
        for number, description in plain.items():
            arrays_of_group = found_under(number, arrays)
            factors = KrigingFactors(
                nugget=description["nugget"], **{name: arrays_of_group[name] for name in _FACTOR_ARRAYS}
            )
            groups.append(
                KrigingGroup(
                    description["family"],
                    description["separable"],
                    trend=PolynomialBasis(space, arrays_of_group["trend"]),
                    factors=factors,
                    **{name: arrays_of_group[name] for name in _GROUP_ARRAYS},
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
