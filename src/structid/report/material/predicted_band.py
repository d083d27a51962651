"""A predicted response for a section, with bands over the posterior draws, computed once for all channels."""

from __future__ import annotations

from functools import cached_property
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
        self.draws, self.best, self.observation = draws, best, observation

    @property
    def time(self) -> Float[np.ndarray, " time"]:
        """Times of the response, or of the sensor's samples."""
        return self.draws.time if self.observation is None else self.observation.time

    def _edges(self, edges: Edges) -> Edges:
        if self.observation is None:
            return edges
        low, high = map(self.observation.instrument.edge_at_samples, edges)
        return low, high

    @cached_property
    def inner(self) -> Edges:
        """Bounds of the 90 % band of the response without errors, in SI, both of shape (time, channel)."""
        return self._edges(self.draws.band())

    @cached_property
    def outer(self) -> Edges:
        """Bounds of the 90 % band with errors, in SI, both of shape (time, channel)."""
        return self._edges(self.draws.band(discrepancy=True))

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
            self.draws.channels[column],
            unit,
            reference="" if reference is None else reference[0],
        )
