"""A predicted response for a section, with bands over the posterior draws, computed once for all channels."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from structid.core.units import factor
from structid.figures import response as figures
from structid.inference.prediction.prediction import Prediction

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Edges = tuple[np.ndarray, np.ndarray]


class PredictedBand:
    """Bands of a prediction with and without errors, and the response of the MAP estimate."""

    def __init__(self, draws: Prediction, best: Float[np.ndarray, "time channel"]) -> None:
        self.draws, self.best = draws, best

    @cached_property
    def inner(self) -> Edges:
        """Bounds of the 90 % band of the response without errors, in SI, both of shape (time, channel)."""
        return self.draws.band()

    @cached_property
    def outer(self) -> Edges:
        """Bounds of the 90 % band with errors, in SI, both of shape (time, channel)."""
        return self.draws.band(discrepancy=True)

    def draw(self, column: int, unit: str, reference: tuple[str, np.ndarray] | None) -> Figure:
        """Draw the bands of one channel."""
        by = factor(unit)
        inner, outer = ((low[:, column] / by, high[:, column] / by) for low, high in (self.inner, self.outer))
        return figures.bands(
            self.draws.time,
            None if reference is None else reference[1] / by,
            self.best[:, column] / by,
            inner,
            outer,
            self.draws.channels[column],
            unit,
            reference="" if reference is None else reference[0],
        )
