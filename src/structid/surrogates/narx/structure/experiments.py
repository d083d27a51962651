"""Training data of a NARX from runs: arrays of inputs and outputs in SI, and names of these signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from structid.campaign.runs import Runs
from structid.core.arrays import Array
from structid.core.errors import InputError
from structid.ground_motion.excitation import Excitation


@dataclass(frozen=True)
class NARXSignals:
    """Names of the inputs and outputs of a NARX."""

    inputs: tuple[str, ...]  # names of the inputs in terms: ``x``, or ``x1``, ``x2``, …
    channels: tuple[str, ...]  # Channels of the outputs
    kind: str = ""  # Kind of the excitations

    @classmethod
    def of(cls, excitation: Excitation, channels: Sequence[str]) -> NARXSignals:
        """Name the signals of an excitation and a response."""
        count = excitation.values[:1].size
        return cls(_names("x", count), tuple(channels), excitation.kind)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs in terms: ``y``, or numbered ``y1``, ``y2`` if there are several."""
        return _names("y", len(self.channels))


def _names(letter: str, count: int) -> tuple[str, ...]:
    """Return the letter alone, or numbered if there are several signals."""
    return (letter,) if count == 1 else tuple(f"{letter}{i + 1}" for i in range(count))


@dataclass(frozen=True, eq=False)
class Experiments:
    """Training data of a NARX from runs."""

    x: Float[np.ndarray, "run time input"]  # inputs in SI; zero after the end of a shorter record
    y: Float[np.ndarray, "run time output"]  # outputs in SI; zero after the end of a shorter record
    counted: Bool[np.ndarray, "run time"]  # True for samples that are used, after the washout
    dt: float  # Time step [s]
    signals: NARXSignals  # Names of the signals

    @classmethod
    def of(cls, runs: Runs, dt: float, washout: float = 0.0) -> Experiments:
        """Collect the arrays of runs."""
        used = [runs.records[i] for i in runs.record_of_run]
        samples = max(len(r) + r.dropped_samples for r in used)
        x = np.zeros((len(runs), samples, used[0].values[:1].size))
        y = np.zeros((len(runs), samples, len(runs.channels)))
        counted = np.zeros((len(runs), samples), dtype=bool)
        values = runs.values
        for row, record in enumerate(used):
            # The lead-in of a periodic record is not measured, but the response is periodic like the record.
            periods = 1 + record.lead_in_periods
            end = periods * len(record)
            x[row, :end] = np.tile(record.values.reshape(len(record), -1), (periods, 1))
            y[row, :end] = np.tile(values[row, : len(record)], (periods, 1))
            counted[row, record.dropped_samples + round(washout / dt) : end] = True
        if not counted.any(axis=1).all():
            raise InputError("washout", f"{washout:g} s", "a time shorter than the shortest record")
        return cls(x, y, counted, dt, NARXSignals.of(used[0], runs.channels))


def input_signals(stages: Float[Array, "time 1 3 *motion"]) -> Float[Array, "time input"]:
    """Return the samples of an excitation and its lead-in, from its values at the stages of the integrator."""
    return stages[:, 0, 0].reshape(stages.shape[0], -1)
