"""The true posterior at points requested during a certification."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.certification.model_runs import ModelRuns, ReportActivity, noise_doubts
from structid.inference.likelihood.posterior import Posterior
from structid.inference.target import Target


class Truth:
    """The true posterior, evaluated at successive sets of requested points."""

    def __init__(self, posterior: Target, folder: Path | None, executor: Any, report: ReportActivity | None) -> None:
        self.posterior, self.folder, self.executor, self.report = posterior, folder, executor, report
        self.runs: ModelRuns | None = None
        self.theta = np.empty((0, posterior.dimension))
        self.log_density = np.empty(0)
        self.count = 0

    def at(self, theta: Float[np.ndarray, "point parameter"]) -> Float[np.ndarray, " point"]:
        """Run the model at some points, and return the true log densities."""
        log_true = self._run(theta)
        log_true = np.where(np.isfinite(log_true), log_true, -np.inf)
        self.theta, self.log_density = np.concatenate([self.theta, theta]), np.concatenate([self.log_density, log_true])
        return log_true

    def twice(self) -> tuple[str, ...]:
        """Repeat the run at the first point, to detect a model that is not deterministic."""
        return noise_doubts(float(self.log_density[0]), float(self._run(self.theta[:1])[0]))

    @property
    def impossible(self) -> np.ndarray:
        """True for each point at which the model's density is zero although no run failed."""
        none = np.zeros(len(self.theta), dtype=bool)
        return none if self.runs is None else self.runs.collapsed(slice(len(self.theta)))

    def _run(self, theta: np.ndarray) -> np.ndarray:
        self.count += len(theta)
        if not isinstance(self.posterior, Posterior):
            return np.asarray(self.posterior.log_density(theta))
        points = np.asarray(self.posterior.model_parameters(theta))
        if self.runs is None:
            self.runs = ModelRuns(self.posterior, points, self.folder, self.executor, self.report)
            self.runs.make()
            self.runs.refuse_rest()
        else:
            self.runs.make(points)
        last = slice(len(self.runs) - len(points), None)
        return np.asarray(self.posterior.given(self.runs.responses(last)).log_density(theta))
