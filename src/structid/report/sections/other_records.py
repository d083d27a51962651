"""Predictions for records that were not measured."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np

from structid.errors import InputError
from structid.figures.style import pretty_unit
from structid.ground_motion.record import GroundMotion
from structid.inference.assessment.prediction import predict
from structid.inference.likelihood.posterior import Posterior
from structid.report.material import PosteriorMaterial
from structid.report.predicted_band import PredictedBand
from structid.report.section import Drawing, Picture, Section, Table
from structid.report.tables import number
from structid.units import factor, label


class _OtherRecord:
    """Prediction for one record."""

    def __init__(self, material: PosteriorMaterial, record: GroundMotion) -> None:
        self.name, self._record, self._material = record.name, record, material

    @cached_property
    def _posterior(self) -> Posterior:
        """The sampled posterior, or the model's own where the surrogate knows only its own records."""
        posterior = self._material.posterior
        try:
            posterior.model.check_excitation(self._record)
        except InputError:
            return self._material.true_posterior
        return posterior

    @cached_property
    def band(self) -> PredictedBand:
        """The response of draws, and of the MAP estimate."""
        material = self._material
        result = material.result
        draws = predict(self._posterior, material.draws, self._record, seed=result.seed, drift=result.drift)
        best = predict(self._posterior, material.best[None], self._record, scaled=False)
        return PredictedBand(draws, best.response[0])


def _others(material: PosteriorMaterial) -> list[_OtherRecord]:
    """One for each record; tables and figures share what they simulate."""
    key = "other records"
    if key not in material.shared:
        material.shared[key] = [_OtherRecord(material, record) for record in material.other_records]
    found: list[_OtherRecord] = material.shared[key]
    return found


def _tables(material: PosteriorMaterial) -> list[Table]:
    rows = [
        [other.name, label(channel, pretty_unit(unit)), *(number(v, high - low) for v in (low, median, high))]
        for other in _others(material)
        for channel, unit, low, median, high in _peaks(other)
    ]
    return [Table("Peak response", (["record", "largest", "5 %", "median", "95 %"], rows))] if rows else []


def _words(material: PosteriorMaterial) -> list[str]:
    if not material.other_records:
        return []
    words = [
        "The peak is that of the structure: of the response with the model's own error, without the instrument's noise. The inner "
        "band is of the response alone, the outer one of what an instrument would show."
    ]
    draws = _others(material)[0].band.draws
    if draws.peak_ratio is None or (draws.peak_ratio == 1.0).all():
        return words
    ratios = [f"{ratio:.2f} for the {name}" for name, ratio in zip(draws.channels, draws.peak_ratio, strict=True)]
    return [
        *words,
        "The measured peak, over the one that is predicted of the measured record in the same way, is "
        f"{', '.join(ratios)}. One record does not tell whether other peaks are off by as much. The bands of the peaks allow "
        "for none of it and for all of it.",
    ]


def _peaks(other: _OtherRecord) -> Iterator[tuple[str, str, float, float, float]]:
    """Channel, display unit, and quantiles of the largest response in it."""
    for column, channel in enumerate(other.band.draws.channels):
        unit = other.band.draws.units[channel].display
        low, median, high = np.quantile(other.band.draws.peaks[:, column] / factor(unit), [0.05, 0.5, 0.95])
        yield channel, unit, low, median, high


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    channels = material.observations[0].channels
    return [
        functools.partial(_band, other, number_of_it, column)
        for number_of_it, other in enumerate(_others(material), start=1)
        for column in range(len(channels))
    ]


def _band(other: _OtherRecord, number_of_it: int, column: int, folder: Path) -> Picture:
    draws = other.band.draws
    channel = draws.channels[column]
    name = f"other_{number_of_it}_{channel}"
    other.band.draw(column, draws.units[channel].display, None, folder / name)
    return Picture(name, f"Predicted {channel} for {other.name}.")


SECTION = Section(
    "other-records",
    "Other records",
    _drawings,
    _tables,
    _words,
    "The bands allow for the drift of the parameters and for errors that grow with the motion as they did on the measured record. "
    "What the structure does beyond that, as in a much stronger earthquake, they need not hold.",
)
