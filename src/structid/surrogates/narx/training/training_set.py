"""Training experiments of a NARX, with scaled signals.

"The thesis" is the MSc thesis in docs/bibliography.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from structid.engine.lanes.signals import Signals
from structid.surrogates.narx.structure.experiments import Experiments
from structid.surrogates.narx.structure.recursion import Recursion


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Experiments with scaled signals."""

    x: Float[np.ndarray, "run time input"]  # Inputs
    y: Float[np.ndarray, "run time output"]  # Outputs
    counted: Bool[np.ndarray, "run time"]  # True for samples that are used; false after the end of a shorter record
    weights: Float[np.ndarray, " run"]  # Weight of the error of each run

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, rows: np.ndarray) -> TrainingSet:
        return TrainingSet(self.x[rows], self.y[rows], self.counted[rows], self.weights[rows])

    def alike(self) -> TrainingSet:
        """Return a copy of the data with equal weights."""
        return replace(self, weights=np.ones(len(self)))

    @cached_property
    def spread(self) -> np.ndarray:
        """Σ (y − ȳ)² of every run and output, shape (run, output): the denominator of the errors (thesis eq. 2.65)."""
        count = self.counted.sum(axis=1)[:, None]
        y = np.where(self.counted[:, :, None], self.y, 0.0)
        square = np.sum(y**2, axis=1) - np.sum(y, axis=1) ** 2 / count
        return np.asarray(np.maximum(square, 1e-300))

    @cached_property
    def signals(self) -> Signals:
        """All signals in one array, shape (run, time + 1, inputs + outputs + 1), for `Recursion.free_loop`.

        The last column marks the used samples. The last row is not used; it is for the step beyond the record.
        """
        # Filled in place: for long records, each copy takes as much as all runs.
        inputs, outputs = self.x.shape[2], self.y.shape[2]
        signals = np.empty((len(self), self.x.shape[1] + 1, inputs + outputs + 1))
        signals[:, :-1, :inputs], signals[:, :-1, inputs:-1], signals[:, :-1, -1] = self.x, self.y, self.counted
        signals[:, -1], signals[:, -1, -1] = signals[:, -2], 0.0
        return Signals(signals)


def training_set(experiments: Experiments, recursion: Recursion) -> TrainingSet:
    """Scale the signals of experiments."""
    x = experiments.x / np.array([recursion.scales[name] for name in recursion.inputs])
    y = experiments.y / np.array([recursion.scales[name] for name in recursion.outputs])
    return TrainingSet(x, y, experiments.counted, np.ones(len(x)))


def spread_rows(weights: Float[np.ndarray, " row"], most: int) -> np.ndarray:
    """Select rows spread over all rows, more densely where weights are larger."""
    if len(weights) <= most:
        return np.arange(len(weights))
    reached = np.cumsum(weights) / np.sum(weights)
    return np.unique(np.searchsorted(reached, (np.arange(most) + 0.5) / most))
