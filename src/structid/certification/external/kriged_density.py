"""Kriging of a log density between model runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from structid.certification.external.fitted_density import FittedDensity
from structid.probability.bijections import Bijection
from structid.probability.designs import Design
from structid.probability.marginals import Uniform
from structid.probability.space import ParameterSpace
from structid.surrogates.kriging.predictor import KrigingPredictor
from structid.surrogates.kriging.universal_kriging import Kriging

Correlation = Literal["gaussian", "matern52"]
CORRELATIONS: tuple[Correlation, ...] = ("gaussian", "matern52")
FARTHEST = 1e4
"""Largest coordinate of a run in a chart in which a Kriging is fitted; the draws have coordinates of about one."""
NUGGET = 1e-8
"""Noise variance relative to the process variance; it keeps the correlation matrix of close runs regular."""
RUNS_FOR_EACH = 2
"""Minimum number of runs per term of a trend."""

Chart = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Map from φ, (point, parameter), to coordinates that make the log density smooth, and to its first guess, (point,)."""


def standardised_by(points: Float[np.ndarray, "point parameter"]) -> Chart:
    """Return a chart in which the given points have mean zero and unit covariance; its first guess is zero."""
    centre, root = points.mean(axis=0), np.linalg.cholesky(np.atleast_2d(np.cov(points.T)))

    def chart(phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.linalg.solve(root, (phi - centre).T).T, np.zeros(len(phi))

    return chart


def in_parameters(bijection: Bijection, theta: Float[np.ndarray, "point parameter"]) -> Chart:
    """Return a chart of the parameters θ: near a bound, φ diverges while the density hardly changes."""
    standardised = standardised_by(theta)

    def chart(phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inside, jacobian = bijection(phi)
        return standardised(inside)[0], jacobian

    return chart


def normal_by(fitted: FittedDensity) -> Chart:
    """Return a chart in which a fitted density is standard normal; its first guess is that log density."""

    def chart(phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z, slope = fitted.in_normal_coordinates(phi)
        return z, slope - 0.5 * np.sum(z**2, axis=1)

    return chart


@dataclass(frozen=True, eq=False)
class KrigedDensity:
    """A log density with respect to φ, interpolated between known points."""

    chart: Chart  # see `Chart`
    correlation: Correlation  # correlation of the Kriging
    phi: Float[np.ndarray, "run parameter"]  # known points
    values: Float[np.ndarray, " run"]  # log densities there
    kriging: KrigingPredictor  # Kriging of the difference from the chart's first guess

    @classmethod
    def fitted(
        cls,
        chart: Chart,
        correlation: Correlation,
        phi: np.ndarray,
        values: np.ndarray,
        start: KrigingPredictor | None = None,
    ) -> KrigedDensity:
        """Fit an interpolation."""
        z, guess = chart(phi)
        edges = {f"z{index}": Uniform(column.min() - 1.0, column.max() + 1.0) for index, column in enumerate(z.T)}
        space = ParameterSpace(edges)
        settings = Kriging(_trend(*z.shape), correlation, separable=False, nugget=NUGGET)
        return cls(chart, correlation, phi, values, settings.fit(Design(z, space), values - guess, start=start))

    @classmethod
    def best(
        cls,
        forms: Sequence[tuple[Chart, Correlation]],
        phi: np.ndarray,
        values: np.ndarray,
        counts: Float[np.ndarray, " run"],
    ) -> KrigedDensity:
        """Fit all forms, and return the one with the smallest spread of leave-one-out errors.

        The normal coordinates of a fitted density grow beyond all bounds far from the draws: such a chart is left out.
        """
        near = [form for form in forms if np.abs(form[0](phi)[0]).max() < FARTHEST]
        candidates = [cls.fitted(chart, correlation, phi, values) for chart, correlation in near or forms]
        return min(candidates, key=lambda one: one.error(counts))

    def error(self, counts: Float[np.ndarray, " run"]) -> float:
        """Weighted standard deviation of the leave-one-out errors."""
        residuals, shares = self.kriging.leave_one_out_residuals[:, 0], counts / counts.sum()
        return float(np.sqrt(shares @ (residuals - shares @ residuals) ** 2))

    def without(self, left_out: np.ndarray) -> KrigedDensity:
        """Fit the same chart and correlation without some runs."""
        kept = np.setdiff1d(np.arange(len(self.phi)), left_out)
        return self.fitted(self.chart, self.correlation, self.phi[kept], self.values[kept], self.kriging)

    def believing(
        self, phi: Float[np.ndarray, "point parameter"], values: Float[np.ndarray, " point"]
    ) -> KrigedDensity:
        """Refit with predicted values added as runs at further points, so that the Kriging is certain there."""
        return self.fitted(
            self.chart,
            self.correlation,
            np.concatenate([self.phi, phi]),
            np.concatenate([self.values, values]),
            self.kriging,
        )

    def mean_at(self, phi: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, " point"]:
        """Predict the log density."""
        z, guess = self.chart(phi)
        return np.asarray(guess + self.kriging.predict(z)[:, 0])

    def at(self, phi: Float[np.ndarray, "point parameter"]) -> tuple[np.ndarray, np.ndarray]:
        """Predict the log density, and its standard deviation."""
        z, guess = self.chart(phi)
        mean, deviation = self.kriging.predict(z, return_std=True)
        return guess + mean[:, 0], deviation[:, 0]


def _trend(runs: int, dimension: int) -> Literal["constant", "linear", "quadratic"]:
    """Return the trend of the highest degree for which there are enough runs."""
    if runs >= RUNS_FOR_EACH * (dimension + 1) * (dimension + 2) // 2:
        return "quadratic"
    return "linear" if runs >= RUNS_FOR_EACH * (dimension + 1) else "constant"
