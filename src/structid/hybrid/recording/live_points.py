"""Points of a running hybrid test for a live view, read from its recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from structid.hybrid.control.tracking import energy_error, root_mean_square_error, tracking_indicator
from structid.hybrid.recording.recorder import Following
from structid.hybrid.recording.result_file import About

AT_ONCE = 400
"""Largest number of points of a channel in one answer; a longer series is thinned."""


class LivePoints:
    """Live data of one test."""

    def __init__(self, store: Path) -> None:
        self._following = Following(store)
        self._about: About | None = None
        self._moves = np.zeros((0, 4, 0))
        self._floors = np.zeros((0, 0))

    def read(self) -> None:
        """Read the new rows."""
        rows = self._following.new_rows()
        if not len(rows):
            return
        if self._about is None:
            self._about = About.from_plain(self._following.about)
            self._moves = np.zeros((0, 4, len(self._about.description.channels)))
        result = self._about.result(rows, [])
        assert result.histories is not None  # there are rows
        moves = np.stack([result.moves.target, result.moves.command, result.moves.measured, result.moves.force], axis=1)
        self._moves = np.concatenate([self._moves, moves])
        floors = result.histories.coarse.u
        self._floors = np.concatenate([self._floors.reshape(-1, floors.shape[1]), floors])

    def since(self, moves: int, steps: int) -> dict[str, Any]:
        """Return the data after the given numbers of moves and steps, as JSON-compatible values."""
        if self._about is None:
            return {}
        about, channels = self._about, []
        target, measured, force = self._moves[:, 0], self._moves[:, 2], self._moves[:, 3]
        stride = max(1, -(-(len(self._moves) - moves) // AT_ONCE))
        for k, channel in enumerate(about.description.channels):
            channels.append(
                {
                    "name": channel.name,
                    "unit": channel.unit,
                    "measured": measured[moves::stride, k].tolist(),
                    "force": force[moves::stride, k].tolist(),
                    "error": _finite(root_mean_square_error(target[:, k], measured[:, k]))
                    if np.any(target[:, k])
                    else None,
                    "indicator": _finite(tracking_indicator(target[:, k], measured[:, k])[-1]) if len(target) else None,
                    "energy": _finite(energy_error(force[:, k], target[:, k], measured[:, k])[-1])
                    if len(target)
                    else None,
                }
            )
        thin = max(1, -(-(len(self._floors) - steps) // AT_ONCE))
        return {
            "record": about.record.name,
            "specimen": about.description.name,
            "planned": about.feasibility.steps,
            "dt": about.frame.dt,
            "moves": len(self._moves),
            "steps": len(self._floors),
            "channels": channels,
            "time": (np.arange(steps, len(self._floors), thin) * about.frame.dt).tolist(),
            "floors": self._floors[steps::thin].T.tolist(),
        }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
