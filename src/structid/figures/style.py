"""The common style of all figures, labels and units of axes, kernel densities, and saving."""

from __future__ import annotations

import functools
import os
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from jaxtyping import Float

from structid.core.notebook import shown_as_pictures
from structid.core.units import label, unbracketed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Drawing = TypeVar("Drawing", bound=Callable[..., Any])

LABEL_WIDTH = 21
"""Largest number of characters per line of a label along the vertical axis of a low panel."""

MEASURED, MODEL, PRIOR, ACCENT, MUTED = "#1a1a1a", "#c1440e", "#8a8f98", "#1f6f8b", "#b8bcc4"
"""Colours: measurement, model (posterior), prior, accent, secondary lines."""
CYCLE = ("#1f6f8b", "#c1440e", "#6a994e", "#7b4b94", "#bc8034", "#386641")
"""Colours of several lines of the same kind."""
WIDTH = 7.4
"""Width of a full figure [inch]."""
LONGEST_TAIL = 2.0
"""Largest length of a tail shown beyond the central 90 % of the draws, in widths of this 90 % range. Normal and exponential
tails are shorter than this limit."""

_RC = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e8eb",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.dpi": 110,
    "savefig.dpi": 160,
    "pdf.fonttype": 42,
}


def styled(draw: Drawing) -> Drawing:
    """Decorator that draws in structid's style and leaves the caller's matplotlib settings unchanged."""

    @functools.wraps(draw)
    def wrapped(*args: Any, **settings: Any) -> Any:
        import matplotlib

        with matplotlib.rc_context(_RC):
            return draw(*args, **settings)

    return wrapped  # type: ignore[return-value]


def canvas(rows: int = 1, columns: int = 1, height: float = 2.2, width: float = WIDTH, **settings: Any) -> Any:
    """Make a figure and its axes without changing pyplot's state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown_as_pictures(Figure)
    figure = Figure(figsize=(width, height * rows), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, **settings)


def wide_top(height: float = 2.2, width: float = WIDTH) -> Any:
    """Make a figure with one wide panel above two narrow ones."""
    figure, axes = canvas(1, 1, height=2 * height, width=width)
    axes[0, 0].remove()
    grid = figure.add_gridspec(2, 2)
    return figure, figure.add_subplot(grid[0, :]), (figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1]))


def in_powers_of_ten(unit: str, draws: np.ndarray) -> tuple[float, str]:
    """Choose a power of ten that scales the numbers close to one, so that no axis shows a separate factor."""
    size = float(np.quantile(np.abs(draws), 0.9))
    power = int(np.floor(np.log10(size))) if size > 0 else 0
    if -3 <= power <= 4:
        return 1.0, unit
    raised = str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return 10.0**power, f"10{raised} {unit}".strip()


def finish(figure: Figure, title: str = "", save: str | os.PathLike[str] | None = None) -> Figure:
    """Set the title, and save as PNG and PDF."""
    if title:
        figure.suptitle(title, fontsize=10.5)
    if save is not None:
        target = Path(save)
        target = target.with_suffix("") if target.suffix in (".png", ".pdf") else target
        target.parent.mkdir(parents=True, exist_ok=True)
        # No date and no version in the files: the same draws give the same file.
        figure.savefig(target.with_name(target.name + ".png"), metadata={"Software": None})
        figure.set_layout_engine("none")  # the PDF uses the layout found for the PNG
        figure.savefig(target.with_name(target.name + ".pdf"), metadata={"CreationDate": None})
    return figure


def shown(draws: Float[np.ndarray, "draw ..."]) -> Float[np.ndarray, "2 ..."]:
    """Range of draws that a panel shows: 99.9 % of the draws, with a tail of at most two widths of the central 90 % range."""
    least, low, high, most = np.quantile(draws, [0.0005, 0.05, 0.95, 0.9995], axis=0)
    tail = LONGEST_TAIL * (high - low)
    return np.stack([np.maximum(least, low - tail), np.minimum(most, high + tail)])


def density(
    draws: Float[np.ndarray, " draw"], points: Float[np.ndarray, " point"], low: float, high: float
) -> Float[np.ndarray, " point"]:
    """Kernel density of draws, reflected at the bounds so that no mass lies beyond them."""
    deviation = min(draws.std(), float(np.subtract(*np.quantile(draws, [0.75, 0.25]))) / 1.349 or np.inf)
    width = 1.06 * max(deviation, 1e-300) * draws.size**-0.2
    mirrored = [draws]
    if np.isfinite(low):
        mirrored.append(2 * low - draws)
    if np.isfinite(high):
        mirrored.append(2 * high - draws)
    # The bins cover only the visible range: a distant draw would make all bins coarse.
    first, last = max(draws.min(), points.min()), min(draws.max(), points.max())
    bins = np.linspace(first - 6 * width, max(first, last) + 6 * width, 4097)
    centres = 0.5 * (bins[1:] + bins[:-1])
    counts, _ = np.histogram(np.concatenate(mirrored), bins)
    step = bins[1] - bins[0]
    reach = int(np.ceil(5 * width / step))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step / width) ** 2)
    smooth = np.convolve(counts, kernel / (kernel.sum() * step * draws.size), mode="same")
    value = np.interp(points, centres, smooth)
    return np.where((points >= low) & (points <= high), value, 0.0)


def name_axes(axis: Axes, x: tuple[str, str], y: tuple[str, str]) -> None:
    """Label both axes with names and units."""
    axis.set_xlabel(label(*x))
    axis.set_ylabel(in_lines(label(*y)))


def in_lines(text: str) -> str:
    """Wrap a label that is longer than the height of a low panel, so that neighbouring labels do not overlap."""
    return "\n".join(textwrap.wrap(text, LABEL_WIDTH, break_long_words=False, break_on_hyphens=False)) or text


def plain_ticks(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers; at 1, 2 and 5 if it spans less than two decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    within_two_decades = high < 100 * low
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if within_two_decades else (1.0,)))
    axis.set_major_formatter(FuncFormatter(_plain))
    axis.set_minor_formatter(NullFormatter())


def _plain(value: float, _: int | None = None) -> str:
    return f"{value:g}"


def pretty(name: str) -> str:
    """Name of a parameter or channel for figures."""
    symbols = {
        "alpha": "α",
        "beta": "β",
        "gamma": "γ",
        "gamma_ratio": "γ*",
        "sigma2": "σ²",
        "delta_nu": "δν",
        "delta_eta": "δη",
        "delta_a": "δA",
        "damping_ratio": "ζ",
        "exponent": "n",
        "psi0": "ψ₀",
        "delta_psi": "δψ",
        "lambda_": "λ",
        "zeta0": "ζ₀",
    }
    if name.endswith("_drift"):
        return f"{pretty(name.removesuffix('_drift'))} drift"
    if name.startswith("log "):
        return f"log {pretty(name.removeprefix('log '))}"
    if name.startswith("sigma2_"):
        return f"σ² {pretty(name.removeprefix('sigma2_'))}"
    return symbols.get(name, name.replace("_", " "))


def pretty_unit(unit: str) -> str:
    """Unit with superscript exponents."""
    return unbracketed(unit).replace("^2", "²").replace("^3", "³").replace("*", "·")


def thin(count: int, most: int = 4000) -> slice:
    """Slice that thins a sequence to fewer than twice `most` points."""
    return slice(None, None, max(1, count // most))
