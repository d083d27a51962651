"""Surrogates fitted to the true runs of a calibration: the best of some forms where the posterior is."""

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
from structid.certification.model_runs import TrueRuns
from structid.core.progress import Progress
from structid.inference.likelihood.posterior import Posterior
from structid.surrogates.base import Surrogate, SurrogateSettings

DISCREPANCY_DRAWS = 32
"""Draws of the discrepancy's parameters among which each stored run takes the one that suits it best."""


@dataclass(frozen=True, eq=False)
class SurrogateFits:
    """What surrogates are fitted to."""

    settings: SurrogateSettings  # Of the surrogate
    posterior: Posterior  # With the measurements
    true: TrueRuns  # All true runs
    last: Batch | None  # The last round's, which says where the posterior is; None before the first
    told: Progress  # Called with the percentage of a fit that is done, and 100

    def fit(
        self,
        points: Int[np.ndarray, " point"],
        start: Surrogate | None,
        forms: Sequence[SurrogateSettings] | None = None,
    ) -> tuple[Surrogate, SurrogateSettings]:
        """Fit the best of some forms to the runs of some points.

        If the kind can, it begins with another surrogate, and gives more weight to runs near the posterior.
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
        found: list[Any] = []
        for form in forms:
            found.append(cast(Any, form).fit(runs, self.told, **further))
            if getattr(form, "shares", False):
                further["start"] = found[0]
        if self.last is None or len(found) == 1:
            return found[0], forms[0]
        density, theta = self._densities
        ran = [~np.isnan(response[points]).all(axis=(1, 2)) for response in self.true.responses()]
        best = best_near_the_posterior(found, self.posterior, theta[points], density[points], ran)
        return found[best], forms[best]

    @cached_property
    def _densities(self) -> tuple[np.ndarray, np.ndarray]:
        """At all runs, which say how near they are to the posterior: the same for all fits, also for those without some runs."""
        assert self.last is not None
        return best_densities(self.posterior, self.true, self.last)


def best_densities(posterior: Posterior, true: TrueRuns, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
    """Densities at all true runs, each with the discrepancy parameters that suit it best, chosen among some draws."""
    points, own = true.points, batch.of_the_errors(posterior.model_space.dimension, DISCREPANCY_DRAWS)
    given = posterior.given(true.responses())
    best = np.full(len(points), -np.inf)
    theta = np.concatenate([points, np.tile(own[0], (len(points), 1))], axis=1)
    for some in own:
        trial = np.concatenate([points, np.tile(some, (len(points), 1))], axis=1)
        density = given.log_density(trial)
        better = density > best
        best, theta[better] = np.where(better, density, best), trial[better]
    return best, theta
