"""A response-space surrogate on one record: mean, modes and a regression of the scores."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from structid.surrogates.regression import Regression


@dataclass(frozen=True, eq=False)
class RecordFit:
    """The surrogate on one record."""

    name: str  # name of the record
    samples: int  # number of samples
    mean: Float[np.ndarray, " _"]  # Mean history, scaled
    modes: Float[np.ndarray, "component _"]  # Orthonormal φ_k, scaled
    truncation: Float[np.ndarray, " _"]  # standard deviation over the design of the omitted components, scaled
    scale: Float[np.ndarray, " channel"]  # SI value of one scaled unit
    scores: Regression  # c_k(θ)
    score_deviation: Float[np.ndarray, " component"]  # Root mean square of the leave-one-out residuals of each score

    @property
    def error(self) -> float:
        """Mean leave-one-out error relative to the variation of the histories."""
        left_out = np.sum(self.score_deviation**2) + np.sum(self.truncation**2)
        return float(left_out / self._mean_spread)

    @property
    def _mean_spread(self) -> float:
        # Σ (y − ȳ)² over time, averaged over the design, has a part from the mean history and a part from the variation.
        shape = (self.samples, -1)
        centred = self.mean.reshape(shape) - self.mean.reshape(shape).mean(axis=0)
        modes = self.modes.reshape(len(self.modes), *centred.shape)
        modes = modes - modes.mean(axis=1, keepdims=True)
        variance = np.asarray(self._score_variance)
        return float(np.sum(centred**2) + variance @ np.sum(modes**2, axis=(1, 2)))

    @property
    def _score_variance(self) -> np.ndarray:
        return np.asarray(self.score_deviation**2 / np.maximum(self.scores.leave_one_out_error, 1e-300))
