"""Signals that differ between the runs of a batch, such as measurements, arranged for loops over time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals of many runs."""

    values: Float[np.ndarray, "set time signal"]  # The signals
    set_of_run: Int[np.ndarray, " run"] | None = (
        None  # index of the signals of each run; by default each run has its own signals
    )
    _in_blocks: dict[int, np.ndarray] = field(default_factory=dict, repr=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of samples and number of signals."""
        _, samples, signals = self.values.shape
        return samples, signals

    @property
    def of_runs(self) -> np.ndarray:
        """Signals of every run, shape (run, time, signal)."""
        return self.values if self.set_of_run is None else self.values[self.set_of_run]

    def in_blocks(self, width: int) -> Float[np.ndarray, "block time signal lane"]:
        """Place the signals of the runs in a block side by side, so that the block reads its samples in sequence."""
        if width not in self._in_blocks:
            sets = np.arange(len(self.values)) if self.set_of_run is None else self.set_of_run
            filled = np.pad(sets, (0, -len(sets) % width), mode="edge").reshape(-1, width)
            blocks = np.empty((len(filled), *self.shape, width))
            for block, sets_of_block in zip(blocks, filled, strict=True):
                block[:] = np.moveaxis(self.values[sets_of_block], 0, 2)
            self._in_blocks[width] = blocks
        return self._in_blocks[width]
