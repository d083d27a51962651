"""Figures of a wall of blocks: mesh, deformed shape, strain maps."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from structid.figures.style import ACCENT, MEASURED, MODEL, MUTED, canvas, finish, name_axes, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MASONRY, EDGE, STEEL = "#e9e2d6", "#9a8f7d", "#4d5a66"
"""Colours of the blocks, the block edges and the loading beam."""
OPEN = 0.02
"""Opening above which a joint is drawn as open, as a fraction of the largest opening."""
MOST_NAMES = 40
"""Largest number of blocks for which the figure numbers the blocks."""


@styled
def mesh(
    corners: Float[np.ndarray, "block 4 2"],
    joints: Float[np.ndarray, "joint 2"],
    bars: Float[np.ndarray, "bar 2 2"],
    fixed: Float[np.ndarray, "node 2"],
    loads: Sequence[tuple[float, float, float]],
    points: Sequence[tuple[str, float, float]],
    words: str,
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the blocks with their numbers, joints, beam, supports, loads and named points."""
    figure, axes = canvas(1, 1, height=5.0, width=5.6)
    axis = axes[0, 0]
    _blocks(axis, corners)
    if len(corners) <= MOST_NAMES:
        for number, block in enumerate(corners):
            axis.text(*block.mean(axis=0), f"{number + 1}", ha="center", va="center", fontsize=8, color=EDGE)
    size = float(np.ptp(corners.reshape(-1, 2), axis=0).max())
    axis.plot(*joints.T, "o", ms=3.2, color=MODEL, mew=0, label=f"{len(joints)} joints")
    for number, bar in enumerate(bars):
        axis.plot(*bar.T, color=STEEL, lw=3.5, solid_capstyle="butt", label="loading beam" if number == 0 else None)
    axis.plot(*fixed.T, "^", ms=6, color=MEASURED, mew=0, label="fixed" if len(fixed) else None, clip_on=False)
    for x, y, force in loads:
        arrow = {"arrowstyle": "-|>", "color": ACCENT, "lw": 1.2}
        axis.annotate("", (x, y), (x, y + 0.09 * size), arrowprops=arrow)
        axis.text(x, y + 0.1 * size, f"{force:.3g}", ha="center", va="bottom", fontsize=7.5, color=ACCENT)
    if loads:
        axis.plot([], [], color=ACCENT, lw=1.2, label="vertical load [kN]")
    for name, x, y in points:
        axis.plot(x, y, "s", ms=5, mfc="none", mec=MEASURED)
        axis.annotate(name, (x, y), (4, -10), textcoords="offset points", fontsize=7.5, weight="bold")
    axis.set_ylim(top=float(corners[..., 1].max()) + 0.2 * size)
    axis.set_xlabel(f"x [m]\n{words}")
    axis.set_ylabel("y [m]")
    axis.set_aspect("equal")
    axis.grid(False)
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, columnspacing=1.0)
    return finish(figure, save=save)


@styled
def deformed(
    corners: Float[np.ndarray, "block 4 2"],
    moved: Sequence[np.ndarray],
    faces: Int[np.ndarray, "joint 3"],
    openings: Sequence[np.ndarray],
    titles: Sequence[str],
    scale: float,
    loop: tuple[np.ndarray, np.ndarray, Sequence[int]],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw the deformed wall at some instants, with joints coloured by opening, and the loop with the instants marked."""
    from matplotlib.collections import LineCollection

    figure, (*axes, last) = _panels(len(moved) + 1)
    _loop(last, *loop)
    most = max((float(o.max(initial=0.0)) for o in openings), default=0.0) or 1.0
    every = np.concatenate([(corners + each).reshape(-1, 2) for each in moved])
    limits = np.array([every.min(axis=0), every.max(axis=0)])
    drawn: Any = None
    for axis, displacement, opening, title in zip(axes, moved, openings, titles, strict=True):
        _blocks(axis, corners, fill="none", edge=MUTED, width=0.4)
        shape = corners + displacement
        _blocks(axis, shape)
        open_ones = np.flatnonzero(opening > OPEN * most)
        # Each of the two joints of a face colours one half of the face.
        lines = []
        for number in open_ones:
            block, one, other = faces[number]
            ends = shape[block, one], shape[block, other]
            middle = 0.5 * (ends[0] + ends[1])
            lines.append((ends[0], middle) if number % 2 == 0 else (middle, ends[1]))
        drawn = LineCollection(lines, cmap="plasma", lw=2.4, zorder=3)
        drawn.set_array(opening[open_ones])
        drawn.set_clim(0.0, most)
        axis.add_collection(drawn)
        axis.set(xlim=limits[:, 0], ylim=limits[:, 1])
        axis.set_title(title, fontsize=8.5)
        axis.text(0.99, 0.01, f"× {scale:g}", transform=axis.transAxes, ha="right", fontsize=7.5, color=EDGE)
        _without_axes(axis)
    if drawn is not None:
        figure.colorbar(drawn, ax=[*axes, last], shrink=0.6, aspect=30).set_label("opening of the joints [mm]")
    return finish(figure, save=save)


@styled
def strain_maps(
    x: Float[np.ndarray, " column"],
    y: Float[np.ndarray, " row"],
    maps: Sequence[np.ndarray],
    titles: Sequence[str],
    save: str | os.PathLike[str] | None = None,
) -> Figure:
    """Draw maps of von Mises strain on a common scale."""
    figure, axes = _panels(len(maps))
    most = max(float(np.nanmax(m)) for m in maps) or 1.0
    drawn = None
    for axis, strain, title in zip(axes, maps, titles, strict=True):
        drawn = axis.pcolormesh(x, y, 1e3 * strain, cmap="OrRd", vmin=0.0, vmax=1e3 * most, rasterized=True)
        axis.set_title(title, fontsize=8.5)
        _without_axes(axis)
    if drawn is not None:
        figure.colorbar(drawn, ax=axes, shrink=0.6, aspect=30).set_label("von Mises strain [mm/m]")
    return finish(figure, save=save)


def _panels(count: int) -> tuple[Any, list[Any]]:
    """A figure with `count` axes, three per row."""
    columns = min(count, 3)
    figure, axes = canvas(-(-count // columns), columns, height=2.7)
    for axis in axes.ravel()[count:]:
        axis.remove()
    return figure, list(axes.ravel()[:count])


def _without_axes(axis: Any) -> None:
    """Hide the axes of a wall."""
    axis.set_aspect("equal")
    axis.axis("off")


def _loop(axis: Any, drift: np.ndarray, shear: np.ndarray, instants: Sequence[int]) -> None:
    """Plot base shear against drift, with numbered instants."""
    axis.plot(drift, shear, color=MUTED, lw=0.8)
    for number, instant in enumerate(instants, start=1):
        axis.plot(drift[instant], shear[instant], "o", ms=4, mew=0, color=MODEL)
        axis.annotate(f"{number}", (drift[instant], shear[instant]), (4, 3), textcoords="offset points", fontsize=8)
    name_axes(axis, ("drift", "mm"), ("base shear", "kN"))


def _blocks(axis: Any, corners: np.ndarray, fill: str = MASONRY, edge: str = EDGE, width: float = 0.7) -> Any:
    """Draw blocks as filled quadrilaterals."""
    from matplotlib.collections import PolyCollection

    drawn = PolyCollection(list(corners), facecolors=fill, edgecolors=edge, linewidths=width)
    axis.add_collection(drawn)
    axis.autoscale_view()
    return drawn


@styled
def joint_law(
    curves: Sequence[Sequence[tuple[np.ndarray, np.ndarray, str]]], save: str | os.PathLike[str] | None = None
) -> Figure:
    """Plot the normal traction of a joint against opening, and the tangential traction against slip."""
    figure, axes = canvas(1, 2, height=2.6)
    names = (("opening", "normal traction"), ("slip", "tangential traction"))
    for axis, panel, (jump, traction) in zip(axes[0], curves, names, strict=True):
        for (x, y, name), colour in zip(panel, (MODEL, ACCENT), strict=True):
            axis.plot(x, y, color=colour, lw=1.2, label=name)
        axis.axhline(0.0, color=MUTED, lw=0.6)
        axis.legend(loc="upper right")
        name_axes(axis, (jump, "mm"), (traction, "MPa"))
    return finish(figure, save=save)
