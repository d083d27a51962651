"""Model runs at the points requested by a calibration."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from structid.campaign.runner import Campaign
from structid.campaign.runs import Runs
from structid.campaign.store import CALIBRATION_RUNS
from structid.core.errors import CampaignStoppedError, InputError, Status
from structid.inference.likelihood.posterior import Posterior
from structid.probability.designs import Design

ReportActivity = Callable[[str, int, int], None]
"""Called with the current activity, the amount done, and the total."""

NOISE = 0.01
"""Difference of log densities at one point above which a model is considered noisy [nat]."""


class ModelRuns:
    """Points, and the model's responses there to every record."""

    def __init__(
        self,
        posterior: Posterior,
        points: Float[np.ndarray, "point parameter"],
        folder: Path | None,
        executor: Any,
        report: ReportActivity | None,
    ) -> None:
        self.model, self.space, self.observations = posterior.model, posterior.model_space, posterior.observations
        self.records = tuple({o.record.content_hash: o.record for o in self.observations}.values())
        self.points, self.folder, self.executor, self.report = points, folder, executor, report
        self.retry = False
        self._done: Runs | None = None

    @property
    def design(self) -> Design:
        """Design of the model runs, with every point once for each record."""
        return Design(np.repeat(self.points, len(self.records), axis=0), self.space)

    @property
    def runs(self) -> Runs:
        """All runs made so far."""
        assert self._done is not None  # `make` must be called first
        return self._done

    def make(self, points: Float[np.ndarray, "point parameter"] | None = None) -> None:
        """Run the model at every new point."""
        if points is not None:
            self.points = np.concatenate([self.points, points])
        if self.folder is not None:
            self._done = self._campaign.run(self.executor, retry=self.retry, progress=self._report)
            self.retry = False
        else:
            done = 0 if self._done is None else len(self._done)
            campaign = Campaign(self.model, self.records, self.design[done:], None, self._assignment)
            runs = campaign.run(self.executor, progress=self._report)
            self._done = runs if self._done is None else self._done + runs

    def refuse_another(self) -> None:
        """Check that the stored runs belong to this model and engine."""
        if self.folder is not None:
            self._campaign.refuse_another()

    def adopt(self) -> None:
        """Adopt the stored runs of another version of the model; failed runs will be repeated."""
        self._campaign.adopt()
        self.retry = True

    @property
    def _campaign(self) -> Campaign:
        assert self.folder is not None
        return Campaign(self.model, self.records, self.design, self.folder / CALIBRATION_RUNS, self._assignment)

    @property
    def _assignment(self) -> str | None:
        return "cycle" if len(self.records) > 1 else None

    def _report(self, ended: int, total: int, _failed: int) -> None:
        if self.report is not None:
            self.report("model runs", ended, total)

    def refuse_hopeless(self) -> None:
        """Stop if none of the first runs has completed, since further runs would fail for the same reason."""
        if self.runs.done.any() or (self.runs.status == Status.STRUCTURE_FAILED).any():
            return
        reason, _ = self.runs.failures[0]
        raise CampaignStoppedError(
            f"None of the first {len(self.runs)} model runs has finished. Most frequent reason: {reason.rstrip('.')}. Check the "
            "units of the priors. Correct the model or the priors, test them with structid check, and start again in "
            "another folder."
        )

    def refuse_rest(self) -> None:
        """Refuse a model whose responses are constant."""
        values = self.runs.values[self.runs.done]
        if not len(values):
            return
        moves = np.nanmax(values, axis=1) > np.nanmin(values, axis=1)
        if not moves.any():
            raise InputError(
                f"the model's {', '.join(self.model.channels)}",
                f"a response that is constant in time, in all {len(values)} runs",
                "a response that varies in time",
                "Check that the solver reads the record, and that its response has the record's time step.",
            )

    def responses(self, points: slice = slice(None)) -> list[np.ndarray]:
        """Return the responses at some points to each observation's record."""
        count = len(self.records)
        rows = np.arange(len(self.points))[points]
        hashes = [r.content_hash for r in self.records]
        responses = []
        for observation in self.observations:
            some = self.runs[rows * count + hashes.index(observation.record.content_hash)]
            values = some.values[:, : len(observation.record)]
            responses.append(np.where(some.done[:, None, None], values, np.nan))
        return responses

    def once_more(self, index: int) -> list[np.ndarray]:
        """Repeat the run of a known point, to check that the model is deterministic."""
        other = copy.copy(self)
        other.points, other._done = self.points[[index]], None
        other.folder = None if self.folder is None else self.folder / f"once_more_{index}"
        other.make()
        return other.responses()

    def of_points(self, points: Int[np.ndarray, " point"]) -> Runs:
        """Return the runs at some points for every record."""
        count = len(self.records)
        return self.runs[(points[:, None] * count + np.arange(count)).ravel()]

    @property
    def finished(self) -> np.ndarray:
        """True for each point whose runs have completed on every record, shape (point,)."""
        return np.asarray(self.runs.done.reshape(len(self.points), len(self.records)).all(axis=1))

    def collapsed(self, points: slice) -> Bool[np.ndarray, " point"]:
        """Mark the points where the structure failed on some record: their density is zero, but no run failed."""
        status = self.runs.status.reshape(len(self.points), len(self.records))[points]
        return np.asarray((status == Status.STRUCTURE_FAILED).any(axis=1))

    def __len__(self) -> int:
        return len(self.points)


def noise_doubts(log_density: float, again: float) -> tuple[str, ...]:
    """Report a model that gives two different log densities at a repeated point."""
    difference = abs(again - log_density)
    if not difference > NOISE:
        return ()
    return (
        f"the model is not deterministic: a repeated run changes its log density by {difference:.2g} nats. "
        "Such a model has no posterior; fix its random seed",
    )
