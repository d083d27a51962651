"""Drawing: densities, powers of ten, files."""

import sys
import types
from itertools import combinations, pairwise

import matplotlib
import numpy as np
import pytest
import scipy.stats

from structid.figures import loops, response
from structid.figures.style import canvas, density, finish, in_powers_of_ten, shown, styled


def test_density_of_a_normal_sample_near_and_far_from_it():
    draws = np.random.default_rng(0).standard_normal(20_000)
    points = np.linspace(-3, 3, 61)
    np.testing.assert_allclose(density(draws, points, -np.inf, np.inf), scipy.stats.norm.pdf(points), atol=0.02)
    close = np.linspace(1.0, 1.001, 5)  # a window far narrower than the bandwidth
    np.testing.assert_allclose(density(draws, close, -np.inf, np.inf), scipy.stats.norm.pdf(1.0), atol=0.02)


def test_density_keeps_its_mass_at_a_bound():
    draws = np.random.default_rng(0).random(20_000)
    points = np.linspace(0, 1, 201)
    value = density(draws, points, 0.0, 1.0)
    np.testing.assert_allclose(value, 1.0, atol=0.08)
    assert density(draws, np.array([-0.1, 1.1]), 0.0, 1.0).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("size", "factor", "unit"), [(5.0, 1.0, "m"), (7.4e-5, 1e-5, "10⁻⁵ m"), (3.0e8, 1e8, "10⁸ m")])
def test_powers_of_ten(size, factor, unit):
    found = in_powers_of_ten("m", np.full(10, size))
    assert found[0] == pytest.approx(factor) and found[1] == unit


@pytest.mark.rendered
def test_the_callers_style_is_left_alone(tmp_path):
    before = dict(matplotlib.rcParams)

    @styled
    def draw(save):
        return finish(canvas(1, 1)[0], save=save)

    draw(tmp_path / "a.b")
    assert dict(matplotlib.rcParams) == before
    assert {p.name for p in tmp_path.iterdir()} == {"a.b.png", "a.b.pdf"}


def test_what_a_panel_shows_of_a_long_tail():
    """All of a normal and of an exponential law but one in a thousand; of a tail like 1/x² twice the width of the rest."""
    rng = np.random.default_rng(4)
    usual = np.column_stack([rng.standard_normal(20_000), rng.standard_exponential(20_000)])
    np.testing.assert_array_equal(shown(usual), np.quantile(usual, [0.0005, 0.9995], axis=0))
    long = 1.0 / rng.uniform(size=20_000)
    low, high = np.quantile(long, [0.05, 0.95])
    assert long.max() > 100.0 * high > 100.0 * (shown(long)[1] - high) / 2.0 > 0.0
    assert shown(long)[1] == pytest.approx(high + 2.0 * (high - low))


def test_a_far_draw_leaves_the_density_of_the_others_as_it_is():
    draws = np.append(np.random.default_rng(5).standard_normal(50_000), 1e5)
    points = np.linspace(-3.0, 3.0, 50)
    np.testing.assert_allclose(density(draws, points, -np.inf, np.inf), scipy.stats.norm.pdf(points), atol=0.02)


def test_a_notebook_shows_a_figure_as_a_picture(monkeypatch):
    known = {}
    formatter = types.SimpleNamespace(lookup_by_type=known.__getitem__, for_type=known.__setitem__)
    shell = types.SimpleNamespace(display_formatter=types.SimpleNamespace(formatters={"image/png": formatter}))
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
    figure, axes = canvas()
    axes[0, 0].plot([0.0, 1.0])
    assert known[type(figure)](figure).startswith(b"\x89PNG")
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: None))
    canvas()  # IPython is imported, and no notebook runs


@pytest.mark.parametrize("name", ["velocity", "absolute acceleration 2", "relative displacement of the upper floor"])
def test_labels_of_panels_below_each_other_do_not_overlap(name):
    time = np.linspace(0.0, 10.0, 200)
    wave, edges = np.sin(time), (np.sin(time) - 0.1, np.sin(time) + 0.1)
    for figure in (
        response.bands(time, wave, wave, edges, edges, name, "m/s^2"),
        response.histories(time, [wave] * 3, [name] * 3, ["m/s^2"] * 3),
    ):
        renderer = figure.canvas.get_renderer()
        figure.canvas.draw()
        boxes = [axis.yaxis.label.get_window_extent(renderer) for axis in figure.axes]
        assert len(boxes) == 3 and not any(a.overlaps(b) for a, b in pairwise(boxes))


def figures_with_a_legend_of_their_own():
    time = np.linspace(0.0, 10.0, 400)
    wave = 5.0 * np.sin(3.0 * time) * (1.0 + 0.05 * time)
    loop, other = (wave, 10.0 * np.cos(3.0 * time)), (0.9 * wave, 9.0 * np.cos(3.0 * time))
    title = "Storey 2 under a record with a rather long name, 3 m/s²"
    yield loops.loops(time, loop, other, title)
    yield loops.loops(time, None, other, title)
    yield loops.identified(
        time, wave, {"pattern_search": wave}, loop, {"pattern_search": other}, "velocity", "m/s", title
    )
    edges = wave - 1.0, wave + 1.0
    yield response.bands(time, wave, wave, edges, edges, "absolute acceleration 2", "m/s^2", title=title)


def test_titles_legends_and_panels_do_not_overlap():
    for figure in figures_with_a_legend_of_their_own():
        renderer = figure.canvas.get_renderer()
        figure.canvas.draw()
        parts = [figure._suptitle, *figure.legends, *figure.axes, *(axis.title for axis in figure.axes)]
        parts += [getattr(axis, "_left_title", axis.title) for axis in figure.axes]
        boxes = [part.get_window_extent(renderer) for part in parts]
        boxes = [box for box in boxes if box.width > 1.0]
        assert len(figure.legends) == 1
        assert not any(a.overlaps(b) for a, b in combinations(boxes, 2)), figure._suptitle.get_text()
