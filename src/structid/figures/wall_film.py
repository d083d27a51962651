"""Animation of a wall: the deformed shape over time, and the drift below it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from structid.core.errors import InputError
from structid.figures.style import MODEL, MUTED, canvas, name_axes, styled
from structid.figures.wall import EDGE, MASONRY


@styled
def animation(
    path: Path,
    corners: Float[np.ndarray, "block 4 2"],
    moved: Float[np.ndarray, "frame block 4 2"],
    time: Float[np.ndarray, " time"],
    drift: Float[np.ndarray, " time"],
    instants: Int[np.ndarray, " frame"],
    scale: float,
    per_second: int,
) -> Path:
    """Write the animation to a file."""
    from matplotlib.animation import FuncAnimation
    from matplotlib.collections import PolyCollection

    writer = _writer(path, per_second)
    figure, axes = canvas(2, 1, height=2.6, width=4.6, height_ratios=(3.0, 1.0))
    wall, below = axes[:, 0]
    blocks = PolyCollection(list(corners), facecolors=MASONRY, edgecolors=EDGE, linewidths=0.7)
    wall.add_collection(blocks)
    every = (corners[None] + moved).reshape(-1, 2)
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.03 * (high - low).max()
    wall.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal")
    wall.axis("off")
    title = wall.set_title("", fontsize=8.5)
    below.plot(time, drift, color=MUTED, lw=0.8)
    (past,) = below.plot([], [], color=MODEL, lw=1.2)
    name_axes(below, ("time", "s"), ("drift", "mm"))

    def show(frame: int) -> Any:
        blocks.set_verts(list(corners + moved[frame]))
        upto = instants[frame] + 1
        past.set_data(time[:upto], drift[:upto])
        title.set_text(f"{time[instants[frame]]:.2f} s, displacements × {scale:g}")
        return blocks, past, title

    path.parent.mkdir(parents=True, exist_ok=True)
    FuncAnimation(figure, show, frames=len(instants)).save(path, writer=writer, dpi=90)
    return path


def _writer(path: Path, per_second: int) -> Any:
    from matplotlib.animation import FFMpegWriter, PillowWriter

    if path.suffix.lower() == ".gif":
        return PillowWriter(fps=per_second)
    if path.suffix.lower() != ".mp4":
        raise InputError("animate(path)", f"{path.name}", "a file name ending in .gif or .mp4")
    if shutil.which("ffmpeg") is None:
        raise InputError("animate(path)", "ffmpeg is not installed", "a file name ending in .gif", "Install ffmpeg.")
    return FFMpegWriter(fps=per_second)
