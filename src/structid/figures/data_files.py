"""Figure of the channels of data files: one panel a channel, with what is remarkable marked."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from structid.core.units import label
from structid.data_files.inspection import times_of
from structid.data_files.overview import FileOverview
from structid.figures.style import ACCENT, MODEL, MUTED, canvas, finish, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_PANELS = 24
"""Largest number of channels in a figure."""


@styled
def draw_files(overviews: Sequence[FileOverview], save: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the channels of some files, each in its own unit and in the time base of its file."""
    panels = [(overview, facts) for overview in overviews for facts in overview.channels][:MOST_PANELS]
    figure, axes = canvas(len(panels), 1, height=1.3)
    for axis, (overview, facts) in zip(axes[:, 0], panels, strict=True):
        channel, times = facts.channel, times_of(facts.channel)
        axis.plot(times, channel.values, color=ACCENT, lw=0.6)
        axis.plot(facts.peak_time, facts.peak, "o", color=MODEL, ms=3)
        missing = ~np.isfinite(channel.values)
        if missing.any():
            axis.plot(times[missing], np.full(missing.sum(), facts.mean), ".", color=MUTED, ms=2)
        axis.set_xlim(times[0], times[-1])
        remarks = ", ".join(dict.fromkeys(finding.kind for finding in facts.findings))
        title = f"{Path(overview.path).name}: {channel.name}{f', {channel.quantity}' if channel.quantity else ''}"
        axis.set_title(f"{title} ({remarks})" if remarks else title, loc="left")
        axis.set_ylabel(channel.unit.lstrip("?") or "no unit")
    axes[-1, 0].set_xlabel(label("time", "s"))
    return finish(figure, "", save)
