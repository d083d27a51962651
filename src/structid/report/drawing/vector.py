"""Figures as vector drawings for a page: SVG text, and the positions of the panels for reading values."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from structid.figures.style import styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCALES = ("linear", "log")
"""Axis scales for which the page can convert positions to values."""

_SETTINGS = {"svg.fonttype": "path", "svg.hashsalt": "structid", "svg.image_inline": True}
_PATH = re.compile(r' d="[^"]*"')
_NUMBER = re.compile(r"(\.\d\d)\d+")


@dataclass(frozen=True)
class Panel:
    """Position of a panel in its figure, and the values at its edges."""

    left: float  # relative to the figure's width, from its upper left corner
    top: float  # relative to the figure's height
    width: float  # relative to the figure's width
    height: float  # relative to the figure's height
    x: tuple[float, float]  # values at the left and right edges
    y: tuple[float, float]  # values at the lower and upper edges
    logarithmic: tuple[bool, bool]  # whether the x axis and the y axis are logarithmic
    names: tuple[str, str]  # labels of the two axes
    title: str  # title of the panel


@styled
def svg(figure: Figure) -> str:
    """Render a figure as SVG. The same figure always gives the same string."""
    import matplotlib

    drawn = io.StringIO()
    with matplotlib.rc_context(_SETTINGS):
        figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None})
    return _PATH.sub(lambda path: _NUMBER.sub(r"\1", path[0]), drawn.getvalue())


def panels(figure: Figure) -> list[Panel]:
    """Positions of the panels of a drawn figure."""
    return [_panel(axes) for axes in figure.axes if _is_readable(axes)]


def _is_readable(axes: Axes) -> bool:
    scales = axes.get_xscale(), axes.get_yscale()
    return (
        axes.get_visible() and axes.axison and axes.name == "rectilinear" and all(scale in SCALES for scale in scales)
    )


def _panel(axes: Axes) -> Panel:
    box = axes.get_position()
    left, top, width, height = (round(float(share), 5) for share in (box.x0, 1.0 - box.y1, box.width, box.height))
    return Panel(
        left,
        top,
        width,
        height,
        _ends(axes.get_xlim()),
        _ends(axes.get_ylim()),
        (axes.get_xscale() == "log", axes.get_yscale() == "log"),
        (_shared(axes, "x"), _shared(axes, "y")),
        axes.get_title(loc="left") or axes.get_title(),
    )


def _ends(limits: Any) -> tuple[float, float]:
    first, last = limits
    return float(first), float(last)


def _shared(axes: Axes, which: str) -> str:
    """Label of an axis, or of the panel that shares the axis: in a column, only the lowest panel is labelled."""
    group = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
    labels = [getattr(member, f"get_{which}label")() for member in (axes, *group)]
    return next((label for label in labels if label), "")
