"""Settings and fit of universal Kriging: a trend plus a Gaussian process, with shared or separate correlations of outputs.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from structid.core.cores import blas_threads
from structid.core.errors import InputError, check_choice
from structid.core.progress import Progress, Steps
from structid.core.streams import Purpose, stream
from structid.core.validation import check_arguments
from structid.probability.designs import Design
from structid.surrogates.chaos.multi_indices import multi_indices
from structid.surrogates.chaos.pce import PCE
from structid.surrogates.chaos.polynomial_basis import PolynomialBasis
from structid.surrogates.kriging.correlations import FAMILIES
from structid.surrogates.kriging.hyperparameters import (
    HyperparameterObjective,
    refined_hyperparameters,
    search_hyperparameters,
    stage_sizes,
)
from structid.surrogates.kriging.kriging_system import KrigingData, KrigingFactors
from structid.surrogates.kriging.predictor import KrigingGroup, KrigingPredictor
from structid.surrogates.regression import check_training

SMALL = 500
"""Design size up to which one BLAS thread solves the many small systems; several threads would mostly wait for each other."""

LOST = 0.1
"""Relative leave-one-out residual sum of squares above which a search from previous lengths counts as failed."""


@check_arguments
@dataclass(frozen=True)
class Kriging:
    """Settings of universal Kriging, f(θ) ≈ f(θ)ᵀβ + σ Z(θ) (thesis eq. 2.42, with σ for its σ²).

    Parameters
    ----------
    trend : {"constant", "linear", "quadratic"} or PCE
        Deterministic part; a `PCE` gives PC-Kriging (Schöbi, Sudret & Wiart 2015).
    correlation : {"matern52", "matern32", "exponential", "gaussian"}
        Correlation function.
    separable : bool, optional
        Whether the correlation is a product of one-dimensional correlations; otherwise it is a function of an ellipsoidal
        distance. By default both are fitted, and the fit with the smaller leave-one-out error is used.
    nugget : float or "estimate"
        Variance of the noise relative to the variance of the process; 0 interpolates.
    estimation : {"ml", "cv"}
        Estimation of the hyper-parameters: maximum likelihood, or leave-one-out cross-validation (thesis eq. 2.46).
    shared : bool
        Whether all outputs share one set of correlation lengths, in which outputs of a larger scale have more weight; otherwise
        each output has a separate set.
    starts : int
        Number of gradient searches, started from the best points of the global search.
    seed : int
        Seed of the global search.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> design = si.ParameterSpace(a=si.Uniform(0.0, 1.0)).sample(12, seed=1)
    >>> fitted = si.Kriging(correlation="matern52").fit(design, np.sin(6.0 * design.values))
    >>> bool(abs(fitted.predict(np.array([[0.5]])) - np.sin(3.0)).max() < 1e-2)
    True
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
        if isinstance(self.trend, str):
            check_choice("Kriging.trend", self.trend, ("constant", "linear", "quadratic"))
        check_choice("Kriging.correlation", self.correlation, FAMILIES)
        check_choice("Kriging.estimation", self.estimation, ("ml", "cv"))
        if self.nugget != "estimate" and not (isinstance(self.nugget, (int, float)) and 0 <= self.nugget < np.inf):
            raise InputError("Kriging.nugget", f"{self.nugget!r}", 'a number of 0 or more, or "estimate"')

    def fit(
        self,
        design: Design,
        values: np.ndarray,
        progress: Progress | None = None,
        start: KrigingPredictor | None = None,
    ) -> KrigingPredictor:
        """Fit a Kriging of one or many outputs.

        Parameters
        ----------
        design : Design
            Points, with their parameter space.
        values : array-like, shape (run,) or (run, output)
            Values of the function at these points.
        progress : callable, optional
            Callback whose arguments are the finished and the total number of steps of the search for correlation lengths.
        start : KrigingPredictor, optional
            A Kriging fitted to fewer points. The search starts from the correlation lengths of `start`, and a global
            search follows only if the result predicts poorly. `start` is used only if all outputs share their lengths.

        Returns
        -------
        KrigingPredictor
            Predictor of means and standard deviations at any point.

        Raises
        ------
        InputError
            If a value is not finite, an output is constant, a point occurs twice without a nugget, or there are too few runs
            for the trend.
        """
        theta, outputs = check_training("Kriging.fit", design, values)
        if self.nugget == 0.0:
            _check_distinct(theta)
        groups = [np.arange(outputs.shape[1])] if self.shared else [np.array([k]) for k in range(outputs.shape[1])]
        previous = start.groups[0] if start is not None and self.shared and len(start.groups) == 1 else None
        forms = len(groups) * len(self._forms(theta))
        step_done = Steps(progress, forms * (1 if previous else max(self.starts, 1) * len(stage_sizes(len(theta)))))
        with blas_threads(1 if len(theta) <= SMALL else None):
            fitted = [self._fit_group(design, theta, outputs[:, group], group, previous, step_done) for group in groups]
        return KrigingPredictor(design.space, tuple(fitted))

    def _forms(self, theta: np.ndarray) -> tuple[bool, ...]:
        """Return the values of `separable` to try: the given value, or both if their correlations differ."""
        forms = (False, True) if self.separable is None else (self.separable,)
        return forms[:1] if self.correlation == "gaussian" or theta.shape[1] == 1 else forms

    def _fit_group(
        self,
        design: Design,
        theta: np.ndarray,
        outputs: np.ndarray,
        group: np.ndarray,
        previous: KrigingGroup | None,
        step_done: Steps,
    ) -> KrigingGroup:
        """Fit outputs that share a correlation; the form with the smaller leave-one-out error is kept."""
        trend = self._trend_basis(design, outputs)
        if len(trend) >= len(theta):
            raise InputError(
                "Kriging.fit", f"{len(theta)} runs for a trend of {len(trend)} terms", f"at least {len(trend) + 1} runs"
            )

        def best(previous: KrigingGroup | None, step_done: Steps) -> KrigingGroup:
            forms = [
                self._fit_form(theta, outputs, group, trend, form, previous, step_done) for form in self._forms(theta)
            ]
            return min(forms, key=_left_over)

        group_fit = best(previous, step_done)
        if previous is None or _left_over(group_fit) <= LOST * float(np.sum((outputs - outputs.mean(axis=0)) ** 2)):
            return group_fit
        # Lengths from a few runs may be so short that predictions fail, and small steps do not improve them.
        return min(group_fit, best(None, Steps(None, 1)), key=_left_over)

    def _trend_basis(self, design: Design, outputs: np.ndarray) -> PolynomialBasis:
        """Return the terms of the trend."""
        space = design.space
        if isinstance(self.trend, str):
            degree = {"constant": 0, "linear": 1, "quadratic": 2}[self.trend]
            return PolynomialBasis(space, multi_indices(space.dimension, degree))
        expansion = self.trend.fit(design, outputs)
        # For many outputs with a common trend, keep the terms with most energy, but few enough for the process to be fitted.
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
        previous: KrigingGroup | None,
        step_done: Steps,
    ) -> KrigingGroup:
        """Fit outputs with one form of the correlation."""
        centre, scale = theta.mean(axis=0), theta.std(axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        data = KrigingData((theta - centre) / scale, trend.evaluate(theta), outputs)
        objective = HyperparameterObjective(data, self.correlation, separable, self.nugget, self.estimation)
        if previous is None:
            best = search_hyperparameters(objective, self.starts, stream(self.seed, Purpose.KRIGING_SEARCH), step_done)
        else:
            nugget = [np.log(previous.factors.nugget)] * (self.nugget == "estimate")
            best = refined_hyperparameters(objective, np.append(np.log(previous.lengths / scale), nugget), step_done)
        try:
            factors = KrigingFactors.of(data, objective.matrix(best), objective.diagonal(best))
        except np.linalg.LinAlgError:
            raise InputError(
                "Kriging.fit",
                "some points are too close to be distinguished",
                "points further apart, or a nugget",
                'Use an estimated nugget: nugget="estimate".',
            ) from None
        return KrigingGroup(
            self.correlation, separable, group, centre, scale, data.points, trend, best[: theta.shape[1]], factors
        )


def _left_over(group: KrigingGroup) -> float:
    """Return the leave-one-out residual sum of squares."""
    return float(np.sum(group.leave_one_out_residuals**2))


def _check_distinct(theta: np.ndarray) -> None:
    """Refuse duplicate points."""
    _, first, count = np.unique(theta, axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        row = int(first[np.argmax(count > 1)])
        twin = np.flatnonzero((theta == theta[row]).all(axis=1))
        raise InputError(
            "Kriging.fit",
            f"{int((count - 1).sum())} points are repeated, such as rows {twin[0]} and {twin[1]}",
            "distinct points",
            'Remove the copies, or use a nugget (nugget="estimate").',
        )
