"""Section of a comparison: predictions of the measured response by the classes."""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.core.units import factor
from structid.figures import response as figures
from structid.inference.prediction.prediction import Prediction
from structid.report.material.comparison_material import ComparisonMaterial
from structid.report.section import Drawing, Picture, Section, nothing


def _drawings(material: ComparisonMaterial) -> list[Drawing]:
    return [
        partial(_draw, material, index, column)
        for index, observation in enumerate(material.observations)
        for column in range(len(observation.channels))
    ]


def _draw(material: ComparisonMaterial, index: int, column: int) -> Picture:
    observation = material.observations[index]
    channel = observation.channels[column]
    unit = observation.channel_unit(channel).display

    def edges(prediction: Prediction, discrepancy: bool) -> tuple[np.ndarray, np.ndarray]:
        low, high = map(observation.instrument.edge_at_samples, prediction.band(discrepancy=discrepancy))
        return low[:, column] / factor(unit), high[:, column] / factor(unit)

    inner, outer = ([edges(one.predictions[index], wide) for one in material.classes] for wide in (False, True))
    measured = observation.values[:, column] / factor(unit)
    figure = figures.side_by_side(observation.time, measured, inner, outer, material.names, channel, unit)
    caption = f"Measured {channel} for {observation.record.name} around its peak, and the predictions of the classes."
    suffix = "" if len(material.observations) == 1 else f"_{index + 1}"
    return Picture(f"predictions_{channel}{suffix}", caption, figure)


SECTION: Section[ComparisonMaterial] = Section("measured", "The measurement", _drawings, nothing)
