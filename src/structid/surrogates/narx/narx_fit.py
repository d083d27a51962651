"""Fit of a NARX to runs: signals, structure, coefficients as functions of the parameters, and error of the fit."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from structid.campaign.runs import Runs
from structid.core.progress import Progress, Stages
from structid.probability.designs import Design
from structid.surrogates.chaos.chaos_expansion import ChaosExpansion
from structid.surrogates.chaos.multi_indices import multi_indices
from structid.surrogates.chaos.pce import PCE
from structid.surrogates.chaos.polynomial_basis import PolynomialBasis
from structid.surrogates.fit import (
    FEWEST_RUNS,
    Fit,
    Stopwatch,
    checked_weights,
    common_step,
    fitted_range,
    fitting_runs,
    run_digests,
)
from structid.surrogates.in_coordinates import coordinate_design
from structid.surrogates.kriging.universal_kriging import Kriging
from structid.surrogates.narx.coefficients import Coefficients
from structid.surrogates.narx.parametric_narx import ParametricNARX, with_held_out_spread
from structid.surrogates.narx.settings import NARXSettings, check_terms_of_chaos, held_out_rows
from structid.surrogates.narx.structure.experiments import Experiments
from structid.surrogates.narx.structure.narx_structure import build_recursion
from structid.surrogates.narx.training.free_run import FreeRun, robust_loss
from structid.surrogates.narx.training.least_squares import refined_coefficients, train_free_run
from structid.surrogates.narx.training.one_step_regression import first_coefficients, least_squares_of_each
from structid.surrogates.narx.training.term_selection import select_terms
from structid.surrogates.narx.training.training_set import TrainingSet, spread_rows, training_set
from structid.surrogates.regression import Regression

TRAINING_BOUND = 2.0
"""Bound of outputs during training, as a multiple of the largest output in the data."""

LOSS_SCALE = 1e-3
"""Error above which the loss is logarithmic in the error."""

LAST_STEPS = 4
"""Number of final training steps, which use all runs."""

RESCUE_HORIZONS = (16, 128)
"""Numbers of samples between restarts in preliminary training, which is used if free runs of the regression diverge."""

LOST = 0.1
"""Robust mean error above which free runs of the regression count as diverged."""

HORIZON_STEPS = 4
"""Largest number of training steps with each horizon."""

STAGES = {"selection": 2.0, "regression": 2.0, "horizons": 1.0, "training": 10.0, "refinement": 6.0, "uncertainty": 1.0}
"""Stages of a fit, and their relative durations."""


class NARXFit:
    """One fit, in steps: data, structure, coefficients, uncertainty."""

    def __init__(
        self,
        settings: NARXSettings,
        runs: Runs,
        progress: Progress | None,
        fewest: int = FEWEST_RUNS,
        weights: Float[np.ndarray, " run"] | None = None,
    ) -> None:
        self.settings, self.stages, self.watch = settings, Stages(progress, STAGES), Stopwatch()
        self.kind = type(settings).__name__
        self.runs, self.left_out = fitting_runs(f"{self.kind}.fit", runs, fewest)
        records = [self.runs.records[i] for i in np.unique(self.runs.record_of_run)]
        self.excitation, self.dt = common_step(f"{self.kind}.fit", records)
        self.experiments = Experiments.of(self.runs, self.dt, settings.washout)
        self.recursion = build_recursion(self.experiments, settings.terms, settings.memories)
        self.data = training_set(self.experiments, self.recursion)
        if weights is not None:
            self.data = replace(self.data, weights=checked_weights(f"{self.kind}.fit", weights, runs))
        self.largest = float(np.abs(self.data.y).max())
        self.fitted, self.unseen = held_out_rows(len(self.runs), settings.held_out, settings.seed)
        if settings.selection is not None:
            full = FreeRun(self.recursion, TRAINING_BOUND * self.largest)
            report = self.stages.of("selection")
            self.recursion = select_terms(full, self.data[self.fitted], settings.selection, settings.most_terms, report)
        self.free_run = FreeRun(self.recursion, TRAINING_BOUND * self.largest)

    @cached_property
    def points(self) -> Design:
        """Points of the completed runs, in the coordinates of their space if it has any."""
        return coordinate_design(self.runs.design)

    def _coefficients(
        self,
        trend: ChaosExpansion,
        deviation: Regression | None = None,
        varying: np.ndarray | None = None,
        scale: np.ndarray | None = None,
    ) -> Coefficients:
        space = self.runs.design.space
        return Coefficients(trend, deviation, varying, scale, space if space.coordinates else None)

    def pc_narx(self, pce: PCE) -> ParametricNARX:
        """Fit coefficients that are chaos expansions."""
        if self.settings.training == "per-experiment":
            return self._surrogate(self._interpolated(pce))
        return self._surrogate(self._coefficients(self._joint()))

    def kriging_narx(self, kriging: Kriging, refinements: int) -> ParametricNARX:
        """Fit coefficients that are interpolated by Kriging."""
        if self.settings.training == "per-experiment":
            return self._surrogate(self._interpolated(kriging))
        trend = self._joint()
        start = np.asarray(trend.predict(self.points.values[self.fitted]))
        report = self.stages.of("refinement")
        refined = refined_coefficients(self.free_run, start, self.data[self.fitted], refinements, report)
        return self._surrogate(self._with_deviation(trend, refined - start, kriging))

    def _interpolated(self, regression: PCE | Kriging) -> Coefficients:
        """Interpolate the least-squares coefficients of each experiment, as the thesis does (docs/bibliography.md)."""
        data = self.data[self.fitted]
        coefficients = least_squares_of_each(self.free_run, data)
        space = self.points.space
        mean = PolynomialBasis(space, multi_indices(space.dimension, 0))
        trend = self._expansion(mean, coefficients.mean(axis=0)[:, None], np.ones((len(coefficients), 1)))
        return self._with_deviation(trend, coefficients - coefficients.mean(axis=0), regression)

    def _with_deviation(self, trend: ChaosExpansion, deviation: np.ndarray, regression: PCE | Kriging) -> Coefficients:
        """Add interpolated deviations to the trend, for the coefficients whose deviations vary over the runs."""
        varying = np.flatnonzero(np.ptp(deviation, axis=0) > 1e-12)
        if len(varying) == 0:
            return self._coefficients(trend)
        scale = deviation[:, varying].std(axis=0)
        fitted = regression.fit(self.points[self.fitted], deviation[:, varying] / scale)
        return self._coefficients(trend, fitted, varying, scale)

    def _joint(self) -> ChaosExpansion:
        """Train the coefficients jointly as chaos expansions."""
        basis = self._basis()
        features = basis.evaluate(self.points.values)
        data, rows = self.data[self.fitted], features[self.fitted]
        held_out = (features[self.unseen], self.data[self.unseen]) if len(self.unseen) else None
        start = first_coefficients(self.free_run, rows, data, progress=self.stages.of("regression"))
        if self.settings.steps == 0:
            return self._expansion(basis, start, rows)
        start = self._over_short_horizons(start, rows, data)
        # Most steps use only part of the runs, enough to determine every coefficient.
        steps, report = self.settings.steps, self.stages.of("training")
        some = spread_rows(data.weights, max(len(data) // 4, 3 * len(basis)))
        early = max(steps - LAST_STEPS, 0) if len(some) < len(data) // 2 else 0
        if early:
            start = train_free_run(
                self.free_run,
                start,
                rows[some],
                data[some].alike(),
                held_out,
                early,
                LOSS_SCALE,
                lambda done, _: report(done, steps),
            ).coefficients
        trained = train_free_run(
            self.free_run,
            start,
            rows,
            data,
            held_out,
            steps - early,
            LOSS_SCALE,
            lambda done, _: report(early + done, steps),
        )
        self.stages.done("training")
        return self._expansion(basis, trained.coefficients, rows)

    def _over_short_horizons(self, start: np.ndarray, features: np.ndarray, data: TrainingSet) -> np.ndarray:
        """Train on runs that restart from the measured past, on request or if free runs diverge."""
        horizons = self.settings.horizons
        if horizons is None:
            loss = robust_loss(self.free_run.errors(features @ start.T, data), LOSS_SCALE, data.weights)
            horizons = RESCUE_HORIZONS if loss > np.log1p(LOST / LOSS_SCALE) else ()
        for done, horizon in enumerate(horizons):
            short = FreeRun(self.recursion, self.free_run.bound, horizon)
            start = train_free_run(short, start, features, data, None, HORIZON_STEPS, LOSS_SCALE).coefficients
            self.stages.of("horizons")(done + 1, len(horizons))
        return start

    def _basis(self) -> PolynomialBasis:
        space = self.points.space
        degree = self.settings.degree if space.dimension else 0
        check_terms_of_chaos(self.kind, space, degree, len(self.fitted))
        return PolynomialBasis(space, multi_indices(space.dimension, degree))

    def _expansion(self, basis: PolynomialBasis, coefficients: np.ndarray, features: np.ndarray) -> ChaosExpansion:
        values = features @ coefficients.T
        unknown = np.full(len(coefficients), np.nan)
        degree = int(basis.indices.sum(axis=1).max())
        truncation = ((degree, 1.0),) * len(coefficients)
        return ChaosExpansion(basis, coefficients.T, unknown, truncation, self.points.values[self.fitted], values)

    def _surrogate(self, coefficients: Coefficients) -> ParametricNARX:
        # Use the held-out runs, or all runs if none are held out.
        rows = self.unseen if len(self.unseen) else self.fitted
        predicted = np.asarray(coefficients.predict(self.runs.design.values[rows]))
        errors = self.free_run.errors(predicted, self.data[rows]).mean(axis=1)
        error = float(np.average(errors, weights=self.data.weights[rows]))
        fit = Fit(
            self.kind,
            self.settings.in_words,
            self.runs.design.space,
            self.runs.channels,
            self.excitation,
            self.dt,
            *fitted_range(self.runs.design),
            len(self.runs),
            self.left_out,
            error,
            self.settings.limit,
            self.settings.outside,
            self.watch.seconds,
            run_digests(self.runs),
        )
        largest_input = np.abs(self.experiments.x).max(axis=(0, 1))
        spread = np.ones(len(self.runs.channels))
        surrogate = ParametricNARX(fit, self.recursion, coefficients, self.largest, spread, largest_input)
        with_spread = with_held_out_spread(surrogate, self.runs[rows])
        self.stages.done("uncertainty")
        return with_spread
