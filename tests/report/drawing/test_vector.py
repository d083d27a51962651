"""Figures as vector drawings: the same text every time, places that are kept, values that can be read off."""

import re

import numpy as np
import pytest

from structid.figures.style import canvas
from structid.report.drawing.vector import panels, svg


@pytest.fixture
def figure():
    return three_panels()


def three_panels():
    drawn, axes = canvas(1, 3, sharey=True)
    axes[0, 0].plot([0.0, 10.0], [0.001, 0.004])
    axes[0, 0].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("drift [mm]")
    axes[0, 1].loglog([1.0, 100.0], [0.001, 0.004])
    axes[0, 1].set_title("in decades", loc="left")
    axes[0, 2].axis("off")
    return drawn


def test_the_same_figure_gives_the_same_text(figure):
    first = svg(figure)
    assert first == svg(three_panels()) and first.count("<svg") == 1
    assert "<text" not in first and not re.search(r"<dc:date>|matplotlib\.org/\d|Matplotlib v", first)


def test_places_are_rounded_and_nothing_else_is(figure):
    paths = re.findall(r' d="([^"]*)"', svg(figure))
    assert paths and not any(re.search(r"\.\d{3}", path) for path in paths)
    # The scale of a glyph is a small number outside the paths: rounded, letters would vanish.
    assert re.search(r"scale\(0\.\d{3,}", svg(figure))


def test_a_panel_tells_where_a_value_is_drawn(figure):
    svg(figure)
    width, height = figure.get_size_inches() * figure.dpi
    found = panels(figure)
    assert [p.logarithmic for p in found] == [(False, True), (True, True)]  # the third has no axes
    for panel, axes, point in zip(found, figure.axes, [(3.0, 0.002), (30.0, 0.002)], strict=False):
        x, y = axes.transData.transform(point)
        across = (x / width - panel.left) / panel.width
        up = 1.0 - ((1.0 - y / height) - panel.top) / panel.height
        for share, ends, logarithmic, value in zip(
            (across, up), (panel.x, panel.y), panel.logarithmic, point, strict=True
        ):
            first, last = ends
            read = first * (last / first) ** share if logarithmic else first + (last - first) * share
            assert read == pytest.approx(value, rel=2e-3)


def test_a_panel_has_the_names_of_those_it_shares_axes_with(figure):
    svg(figure)
    first, second = panels(figure)
    assert first.names == ("time [s]", "drift [mm]")
    assert second.names == ("", "drift [mm]") and second.title == "in decades"


def test_a_band_of_many_samples_stays_small():
    drawn, axes = canvas()
    time = np.linspace(0.0, 40.0, 4001)
    axes[0, 0].fill_between(time, np.sin(9.0 * time) - 1.0, np.sin(9.0 * time) + 1.0)
    assert len(svg(drawn)) < 200_000
