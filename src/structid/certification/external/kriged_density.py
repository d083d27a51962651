"""Kriging of a log density that is known at some true runs: what it is between them."""

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
NUGGET = 1e-8
"""Variance of noise relative to that of the process: keeps the correlations of runs close to one another regular."""
RUNS_FOR_EACH = 2
"""Runs for each term of a trend from which on it is tried."""

Chart = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From φ, (point, parameter), to coordinates in which the log density is smooth, and a first guess of it, (point,)."""


def standardised_by(points: Float[np.ndarray, "point parameter"]) -> Chart:
    """Give the chart in which some points have mean zero and unit covariance; its first guess is zero."""
    centre, root = points.mean(axis=0), np.linalg.cholesky(np.atleast_2d(np.cov(points.T)))

    def chart(phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.linalg.solve(root, (phi - centre).T).T, np.zeros(len(phi))

    return chart


def in_parameters(bijection: Bijection, theta: Float[np.ndarray, "point parameter"]) -> Chart:
    """Give the chart of the parameters themselves: near a bound, φ goes far where hardly anything changes."""
    standardised = standardised_by(theta)

    def chart(phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inside, jacobian = bijection(phi)
        return standardised(inside)[0], jacobian

    return chart


def normal_by(fitted: FittedDensity) -> Chart:
    """Give the chart in which a fitted density is standard normal; its first guess is that density."""

    def chart(phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z, slope = fitted.in_normal_coordinates(phi)
        return z, slope - 0.5 * np.sum(z**2, axis=1)

    return chart


@dataclass(frozen=True, eq=False)
class KrigedDensity:
    """A log density with respect to φ, between points where it is known."""

    chart: Chart  # See `Chart`
    correlation: Correlation  # Of the Kriging
    phi: Float[np.ndarray, "run parameter"]  # Where it is known
    values: Float[np.ndarray, " run"]  # What it is there
    kriging: KrigingPredictor  # Of the difference from the chart's first guess

    @classmethod
    def fitted(
        cls,
        chart: Chart,
        correlation: Correlation,
        phi: np.ndarray,
        values: np.ndarray,
        start: KrigingPredictor | None = None,
    ) -> KrigedDensity:
        """Fit one."""
        z, guess = chart(phi)
        edges = {f"z{place}": Uniform(column.min() - 1.0, column.max() + 1.0) for place, column in enumerate(z.T)}
        space = ParameterSpace(None, None, None, **edges)
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
        """Fit that form whose leave-one-out errors vary least."""
        found = [cls.fitted(chart, correlation, phi, values) for chart, correlation in forms]
        return min(found, key=lambda one: one.error(counts))

    def error(self, counts: Float[np.ndarray, " run"]) -> float:
        """Weighted standard deviation of the leave-one-out errors."""
        residuals, shares = self.kriging.leave_one_out_residuals[:, 0], counts / counts.sum()
        return float(np.sqrt(shares @ (residuals - shares @ residuals) ** 2))

    def without(self, left_out: np.ndarray) -> KrigedDensity:
        """Fit the same form to all runs but some."""
        kept = np.setdiff1d(np.arange(len(self.phi)), left_out)
        return self.fitted(self.chart, self.correlation, self.phi[kept], self.values[kept], self.kriging)

    def believing(
        self, phi: Float[np.ndarray, "point parameter"], values: Float[np.ndarray, " point"]
    ) -> KrigedDensity:
        """Add what is predicted at further points, so that it is sure there."""
        return self.fitted(
            self.chart,
            self.correlation,
            np.concatenate([self.phi, phi]),
            np.concatenate([self.values, values]),
            self.kriging,
        )

    def at(self, phi: Float[np.ndarray, "point parameter"]) -> tuple[np.ndarray, np.ndarray]:
        """Predict it."""
        z, guess = self.chart(phi)
        mean, deviation = self.kriging.predict(z, return_std=True)
        return guess + mean[:, 0], deviation[:, 0]


def _trend(runs: int, dimension: int) -> Literal["constant", "linear", "quadratic"]:
    """The highest trend for which there are runs enough."""
    if runs >= RUNS_FOR_EACH * (dimension + 1) * (dimension + 2) // 2:
        return "quadratic"
    return "linear" if runs >= RUNS_FOR_EACH * (dimension + 1) else "constant"
