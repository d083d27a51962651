"""A predicted response as a section draws it: the bands of its draws, computed once for all channels."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np

from structid.figures import response as figures
from structid.inference.assessment.prediction import Prediction
from structid.units import factor

Edges = tuple[np.ndarray, np.ndarray]


class PredictedBand:
    """The bands of a prediction, with and without discrepancy, around the response of the MAP estimate.

    Parameters
    ----------
    draws : Prediction
        The response of draws.
    best : ndarray, shape (time, channel)
        The response of the MAP estimate.
    """

    def __init__(self, draws: Prediction, best: np.ndarray) -> None:
        self.draws, self.best = draws, best

    @cached_property
    def _inner(self) -> Edges:
        return self.draws.band()

    @cached_property
    def _outer(self) -> Edges:
        return self.draws.band(discrepancy=True)

    def draw(self, column: int, unit: str, measured: np.ndarray | None, save: Path) -> None:
        """Draw one channel.

        Parameters
        ----------
        column : int
            Which channel.
        unit : str
            Its display unit.
        measured : ndarray, shape (time,), or None
            The measurement in SI, if there is one.
        save : Path
            Where to save it, without ending.
        """
        by = factor(unit)
        inner, outer = ((low[:, column] / by, high[:, column] / by) for low, high in (self._inner, self._outer))
        figures.bands(
            self.draws.time,
            None if measured is None else measured / by,
            self.best[:, column] / by,
            inner,
            outer,
            self.draws.channels[column],
            unit,
            save=save,
        )
