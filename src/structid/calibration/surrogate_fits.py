"""Surrogate fits of a calibration, which select the form with the smallest error near the posterior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
from jaxtyping import Int

from structid.calibration.next_runs import Batch
from structid.calibration.run_weights import nearness
from structid.calibration.surrogate_forms import best_near_the_posterior
from structid.certification.model_runs import ModelRuns
from structid.core.progress import Progress
from structid.inference.likelihood.posterior import Posterior
from structid.surrogates.base import Surrogate, SurrogateSettings

DISCREPANCY_DRAWS = 32
"""Number of draws of the error model's parameters; each stored run uses the draw with the highest density."""


@dataclass(frozen=True, eq=False)
class SurrogateFits:
    """Data and settings of surrogate fits."""

    settings: SurrogateSettings  # settings of the surrogate
    posterior: Posterior  # posterior with the measurements
    true: ModelRuns  # all model runs
    last: Batch | None  # batch of the last round, near the posterior; None before the first
    progress: Progress  # called with the percentage of a fit that is done, and 100

    def fit(
        self,
        points: Int[np.ndarray, " point"],
        start: Surrogate | None,
        forms: Sequence[SurrogateSettings] | None = None,
    ) -> tuple[Surrogate, SurrogateSettings]:
        """Fit several forms of the surrogate to the runs at some points, and return the best.

        If the kind of surrogate supports it, the fit starts from another surrogate and weights runs near the posterior more.
        """
        forms = getattr(self.settings, "forms", (self.settings,)) if forms is None else forms
        runs = self.true.of_points(points)
        further: dict[str, Any] = {}
        if forms[0].warm_start and start is not None:
            further["start"] = start
        if self.last is None:
            forms = forms[:1]
        elif forms[0].weighted:
            near = nearness(self._densities[0])
            further["weights"] = np.repeat(near[points], len(self.true.records))
        candidates: list[Any] = []
        for form in forms:
            candidates.append(cast(Any, form).fit(runs, self.progress, **further))
            if getattr(form, "shares", False):
                further["start"] = candidates[0]
        if self.last is None or len(candidates) == 1:
            return candidates[0], forms[0]
        density, theta = self._densities
        ran = [~np.isnan(response[points]).all(axis=(1, 2)) for response in self.true.responses()]
        best = best_near_the_posterior(candidates, self.posterior, theta[points], density[points], ran)
        return candidates[best], forms[best]

    @cached_property
    def _densities(self) -> tuple[np.ndarray, np.ndarray]:
        """Log densities at all runs, which measure the runs' closeness to the posterior; the same for all fits."""
        assert self.last is not None
        return best_densities(self.posterior, self.true, self.last)


def best_densities(posterior: Posterior, true: ModelRuns, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest log density at each model run over draws of the error model's parameters, and its point."""
    points, error_parameters = true.points, batch.of_the_errors(posterior.model_space.dimension, DISCREPANCY_DRAWS)
    given = posterior.given(true.responses())
    best = np.full(len(points), -np.inf)
    theta = np.concatenate([points, np.tile(error_parameters[0], (len(points), 1))], axis=1)
    for some in error_parameters:
        trial = np.concatenate([points, np.tile(some, (len(points), 1))], axis=1)
        density = given.log_density(trial)
        better = density > best
        best, theta[better] = np.where(better, density, best), trial[better]
    return best, theta
