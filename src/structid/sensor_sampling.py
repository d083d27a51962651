"""Samples of a sensor with its own sampling rate, as linear combinations of samples on the record's time base.

Between samples, a response is a polynomial through the 6 nearest samples (Lagrange). For a harmonic with s samples per
period, the relative error is at most 5e-6 for s = 20, 4e-4 for s = 10, and 5e-3 for s = 6.3. Near the ends of the record,
the samples are not centred, and in its first two steps there are only 4: the error is larger there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from structid.core.arrays import Array
from structid.engine.array_module import namespace

NODES = 6
"""Number of record samples of a polynomial; more cost time, and the integration of a model is hardly more accurate."""

FEWER_NODES, FIRST_STEPS = 4, 2
"""Number of samples of a polynomial in the first steps of a record; a loop would have to wait for more of them."""

ON_A_SAMPLE = 1e-6
"""Distance, in steps of the record, below which a sensor's sample and a record's sample have the same time."""


class LoopSchedule(NamedTuple):
    """Order of a sensor's samples in a loop over the samples of the record.

    A sensor's sample is computed when the loop has passed all record samples that it needs; a window holds the latest of them.
    """

    sample: Int[np.ndarray, "step slot"]  # index of the sensor's sample; -1 for none
    weights: Float[np.ndarray, "step slot window"]  # weights of the samples in the window
    late: Int[np.ndarray, " late"]  # sensor's samples computed after the last step
    late_weights: Float[np.ndarray, "late window"]


@dataclass(frozen=True, eq=False)
class SensorSampling:
    """A sensor's samples as weighted sums of consecutive record samples."""

    first: Int[np.ndarray, " sample"]  # first record sample of each sum
    weights: Float[np.ndarray, "sample node"]
    steps: int  # samples of the record
    rate: float  # samples of the sensor per step of the record

    @classmethod
    def of(cls, times: Float[np.ndarray, " sample"], dt: float, steps: int) -> SensorSampling | None:
        """Return the sums for sample times within a record; None if they are the samples of the record."""
        position = np.asarray(times) / dt
        nearest = np.clip(np.rint(position).astype(int), 0, steps - 1)
        rate = (len(position) - 1) / max(position[-1] - position[0], ON_A_SAMPLE)
        if np.abs(position - nearest).max(initial=0.0) < ON_A_SAMPLE:
            whole = len(nearest) == steps and bool((nearest == np.arange(steps)).all())
            return None if whole else cls(nearest, np.ones((len(nearest), 1)), steps, rate)
        return cls(*_stencils(position, steps), steps, rate)

    @property
    def on_samples(self) -> bool:
        """Whether every sample of the sensor is at a sample of the record."""
        return bool(self.weights.shape[1] == 1)

    def apply(self, histories: Float[Array, "time *rest"]) -> Float[Array, "sample *rest"]:
        """Return the samples of the sensor, inside JAX or of NumPy arrays."""
        numpy, shape = namespace(histories), (len(self.first),) + (1,) * (histories.ndim - 1)
        if self.on_samples:
            return histories[self.first]
        total = numpy.zeros((len(self.first), *histories.shape[1:]))
        for node, weights in enumerate(self.weights.T):
            total = total + weights.reshape(shape) * histories[self.first + node]
        return total

    @cached_property
    def schedule(self) -> LoopSchedule:
        """Order of the samples in a loop over the record."""
        has_weight = self.weights != 0.0
        nodes = np.arange(self.weights.shape[1])
        needed = self.first + np.where(has_weight, nodes, 0).max(axis=1)  # last record sample of each sum
        slots = max(1, int(np.ceil(self.rate - ON_A_SAMPLE)))
        steps = _steps_in_order(needed, slots)
        late = steps >= self.steps
        last = np.minimum(steps, self.steps - 1)  # last record sample in the window
        window = int((last - self.first).max()) + 1
        in_window = np.zeros((len(steps), window))
        rows, columns = np.nonzero(has_weight)
        in_window[rows, (self.first - last + window - 1)[rows] + columns] = self.weights[rows, columns]
        slot = np.arange(len(steps)) - np.searchsorted(steps, steps)
        sample, weights = np.full((self.steps, slots), -1), np.zeros((self.steps, slots, window))
        regular = np.flatnonzero(~late)
        sample[steps[regular], slot[regular]] = regular
        weights[steps[regular], slot[regular]] = in_window[regular]
        return LoopSchedule(sample, weights, np.flatnonzero(late), in_window[late])


def _steps_in_order(needed: np.ndarray, slots: int) -> np.ndarray:
    """Return the earliest step of each sample that keeps the order, with at most `slots` samples in a step."""
    steps = np.empty(len(needed), dtype=int)
    for sample, earliest in enumerate(needed):
        full = steps[sample - slots] + 1 if sample >= slots else 0
        steps[sample] = max(earliest, full, steps[sample - 1] if sample else 0)
    return steps


def _stencils(position: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first record sample and the weights of the polynomial through the samples around each position."""
    below = np.floor(position).astype(int)
    counts = np.minimum(np.where(below < FIRST_STEPS, FEWER_NODES, NODES), steps)
    first = np.clip(below - counts // 2 + 1, 0, steps - counts)
    weights = np.zeros((len(position), counts.max()))
    for count in np.unique(counts):
        rows = np.flatnonzero(counts == count)
        weights[rows, :count] = _lagrange(position[rows] - first[rows], int(count))
    nearest = np.rint(position).astype(int)
    for row in np.flatnonzero(np.abs(position - nearest) < ON_A_SAMPLE):
        weights[row] = 0.0
        weights[row, nearest[row] - first[row]] = 1.0
    return first, weights


def _lagrange(at: np.ndarray, count: int) -> np.ndarray:
    """Return w_j = Π_{i≠j} (x − i)/(j − i) for the nodes 0, …, count − 1, shape (position, node)."""
    nodes = np.arange(count)
    weights = np.ones((len(at), count))
    for j in nodes:
        for i in nodes[nodes != j]:
            weights[:, j] *= (at - i) / (j - i)
    return weights
