"""Fit of principal components and scores to runs, record by record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from structid.campaign.runs import Runs
from structid.core.errors import InputError
from structid.core.progress import Progress, Stages
from structid.ground_motion.excitation import Excitation
from structid.probability.designs import Design
from structid.surrogates.fit import (
    Fit,
    OutsideRule,
    Stopwatch,
    check_enough,
    common_step,
    fitted_range,
    fitting_runs,
    run_digests,
)
from structid.surrogates.in_coordinates import fitted_in_coordinates
from structid.surrogates.pod.principal_components import principal_components
from structid.surrogates.pod.record_fit import RecordFit
from structid.surrogates.pod.response_space import ResponseSpaceSurrogate
from structid.surrogates.regression import Regression

ScoreRegression = Callable[[str, Design, np.ndarray, Progress], Regression]
"""Function that fits the scores on a record, which is identified by its content hash."""


class PODSettings(Protocol):
    """Settings of every response-space surrogate."""

    @property
    def energy(self) -> float:
        """Fraction of the variance that the components may omit."""

    @property
    def limit(self) -> float:
        """Largest mean relative error accepted in a posterior."""

    @property
    def outside(self) -> OutsideRule:
        """Treatment of points outside the range of the design."""

    @property
    def in_words(self) -> dict[str, Any]:
        """All settings, JSON-compatible."""


def check_runs(kind: str, design: Design, records: Sequence[Excitation]) -> None:
    """Check planned runs: each record needs enough runs, and all records need the same time step."""
    common_step(f"{kind}.fit", records)
    fewest = len(design) // len(records)
    check_enough(f"{kind}.fit", fewest, f"{fewest} runs on each of {len(records)} records")


def fit_records(
    settings: PODSettings, regression: ScoreRegression, runs: Runs, progress: Progress | None, reach: float = 0.0
) -> ResponseSpaceSurrogate:
    """For every record, fit principal components and a regression of their scores."""
    watch = Stopwatch()
    kind = type(settings).__name__
    done, left_out = fitting_runs(f"{kind}.fit", runs)
    used = _by_record(done)
    excitation, dt = common_step(f"{kind}.fit", [some.records[0] for some in used.values()])
    fits: dict[str, RecordFit] = {}
    stages = Stages(progress, dict.fromkeys(used, 1.0))
    for content_hash, some in used.items():
        check_enough(f"{kind}.fit", len(some), f"{len(some)} runs on '{some.records[0].name}'")
        fits[content_hash] = _fit_record(some, regression, settings.energy, stages.of(content_hash))
        stages.done(content_hash)
    fit = Fit(
        kind,
        settings.in_words,
        done.design.space,
        done.channels,
        excitation,
        dt,
        *fitted_range(done.design),
        len(done),
        left_out,
        float(np.mean([f.error for f in fits.values()])),
        settings.limit,
        settings.outside,
        watch.seconds,
        run_digests(done),
        reach,
    )
    return ResponseSpaceSurrogate(fit, fits)


def _by_record(runs: Runs) -> dict[str, Runs]:
    """Group runs by the content of their record; a record that appears twice counts as one record."""
    hashes = [r.content_hash for r in runs.records]
    of_run = np.array([hashes.index(hashes[i]) for i in runs.record_of_run])
    merged = replace(runs, record_of_run=of_run)
    return {hashes[i]: merged.on(int(i)) for i in np.unique(of_run)}


def _fit_record(runs: Runs, regression: ScoreRegression, left_out_energy: float, progress: Progress) -> RecordFit:
    record = runs.records[0]
    values = runs.values[:, : len(record)]
    scale = values.std(axis=(0, 1))
    if not scale.all():
        still = runs.channels[int(np.argmin(scale))]
        raise InputError(
            "fit", f"the channel '{still}' is constant in every run on '{record.name}'", "channels that vary"
        )
    table = (values / scale).reshape(len(values), -1)
    mean, modes, scores, truncation = principal_components(table, left_out_energy)
    predictor = fitted_in_coordinates(
        runs.design, lambda design: regression(record.content_hash, design, scores, progress)
    )
    deviation = np.sqrt(predictor.leave_one_out_error * scores.var(axis=0))
    return RecordFit(record.name, len(record), mean, modes, truncation, scale, predictor, deviation)
