"""A predicted response for a section, with bands over the posterior draws, computed once for all channels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from structid.core.units import factor
from structid.figures import response as figures
from structid.inference.prediction.prediction import Prediction
from structid.observation import Observation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Edges = tuple[np.ndarray, np.ndarray]


class PredictedBand:
    """Bands of a prediction with and without errors, and the response of the MAP estimate.

    For the measured record, they are drawn at the samples of the sensor.
    """

    def __init__(
        self, draws: Prediction, best: Float[np.ndarray, "time channel"], observation: Observation | None = None
    ) -> None:
        self.best, self.observation = best, observation
        # The draws themselves are not kept: a report has many predictions, each of hundreds of histories.
        self.channels, self.units = draws.channels, draws.units
        self.peaks, self.peak_ratio = draws.peaks, draws.peak_ratio
        # Times of the response, or of the sensor's samples
        self.time = draws.time if observation is None else observation.time
        # Bounds of the 90 % bands without and with errors, in SI, all of shape (time, channel)
        self.inner, self.outer = self._edges(draws.band()), self._edges(draws.band(discrepancy=True))

    def _edges(self, edges: Edges) -> Edges:
        if self.observation is None:
            return edges
        low, high = map(self.observation.instrument.edge_at_samples, edges)
        return low, high

    def draw(self, column: int, unit: str, reference: tuple[str, np.ndarray] | None) -> Figure:
        """Draw the bands of one channel."""
        by = factor(unit)
        inner, outer = ((low[:, column] / by, high[:, column] / by) for low, high in (self.inner, self.outer))
        return figures.bands(
            self.time,
            None if reference is None else reference[1] / by,
            self.best[:, column] / by,
            inner,
            outer,
            self.channels[column],
            unit,
            reference="" if reference is None else reference[0],
        )
