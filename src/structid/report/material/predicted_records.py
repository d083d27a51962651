"""Predictions for unmeasured records, and the true responses of a virtual experiment to them."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from structid.core.units import factor
from structid.ground_motion.record import GroundMotion
from structid.inference.likelihood.posterior import Posterior
from structid.inference.prediction.prediction import Prediction, first_that_takes, predict
from structid.models.finer_steps import simulate_in_steps_it_needs
from structid.report.material.material import PosteriorMaterial
from structid.report.material.predicted_band import PredictedBand
from structid.report.tables import number


class Peak(NamedTuple):
    """The largest response of a channel, in its display unit."""

    channel: str  # channel
    unit: str  # unit of the channel
    low: float  # 5 % quantile
    median: float  # 50 % quantile
    high: float  # 95 % quantile
    truth: float | None  # true value of a virtual experiment

    @property
    def cells(self) -> list[str]:
        """Quantiles and, if known, the true value, as table cells."""
        values = [self.low, self.median, self.high, *([] if self.truth is None else [self.truth])]
        return [number(value, self.high - self.low) for value in values]


class PredictedRecord:
    """Prediction for one record."""

    def __init__(self, material: PosteriorMaterial, record: GroundMotion) -> None:
        self.name, self.record, self._material = record.name, record, material

    @property
    def channels(self) -> tuple[str, ...]:
        """Predicted channels; default: the measured channels."""
        measured = dict.fromkeys(channel for o in self._material.observations for channel in o.channels)
        return self._material.predicted_channels or tuple(measured)

    @cached_property
    def _posterior(self) -> Posterior:
        """The sampled posterior, or the posterior with the model if the surrogate cannot predict the record or channels."""
        sampled, true = self._material.posterior, self._material.true_posterior
        return (
            first_that_takes(self.record, sampled, true) if set(self.channels) <= set(sampled.model.channels) else true
        )

    @cached_property
    def band(self) -> PredictedBand:
        """Response of the draws and of the MAP estimate."""
        material = self._material
        result = material.result
        draws = predict(
            self._posterior, material.draws, self.record, self.channels, seed=result.seed, drift=result.drift
        )
        return PredictedBand(draws, self._best.response[0])

    @cached_property
    def _best(self) -> Prediction:
        return predict(self._posterior, self._material.best[None], self.record, self.channels, scaled=False)

    @property
    def runs(self) -> bool:
        """Whether the run of the MAP estimate succeeds."""
        return len(self._best.response) > 0

    @cached_property
    def truth(self) -> np.ndarray | None:
        """Response of the true model of a virtual experiment, shape (time, channel); None if unknown."""
        model = self._material.truths[0]
        if model is None:
            return None
        recording = model.recording(*self.band.channels)
        simulated = simulate_in_steps_it_needs(recording, np.zeros((1, 0)), self.record)
        return np.asarray(simulated.values[0])

    def inside(self, column: int) -> float | None:
        """Fraction of the true history inside the outer 90 % band."""
        if self.truth is None:
            return None
        low, high = (edge[:, column] for edge in self.band.outer)
        return float(np.mean((self.truth[:, column] >= low) & (self.truth[:, column] <= high)))

    def peaks(self) -> list[Peak]:
        """Largest response in each channel."""
        band, peaks = self.band, []
        for column, channel in enumerate(band.channels):
            unit = band.units[channel].display
            by = factor(unit)
            low, median, high = np.quantile(band.peaks[:, column] / by, [0.05, 0.5, 0.95])
            truth = None if self.truth is None else float(np.abs(self.truth[:, column]).max() / by)
            peaks.append(Peak(channel, unit, float(low), float(median), float(high), truth))
        return peaks


def predicted_records(material: PosteriorMaterial) -> list[PredictedRecord]:
    """Predictions for the other records of the study under which the model runs, computed once."""
    return [prediction for prediction in _every_record(material) if prediction.runs]


def names_of_failing_records(material: PosteriorMaterial) -> list[str]:
    """Names of the other records of the study under which the model fails."""
    return [prediction.name for prediction in _every_record(material) if not prediction.runs]


def _every_record(material: PosteriorMaterial) -> list[PredictedRecord]:
    key = "other records"
    if key not in material.shared:
        material.shared[key] = [PredictedRecord(material, record) for record in material.other_records]
    predictions: list[PredictedRecord] = material.shared[key]
    return predictions
