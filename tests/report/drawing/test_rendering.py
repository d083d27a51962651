"""Figures become pictures in a process of its own; whatever happens to it, a page gets its pictures."""

import json

import pytest

from structid.figures.style import canvas
from structid.models.pictures import Film
from structid.report.drawing.drawn_sections import draw
from structid.report.drawing.rendering import Renderer, rendered
from structid.report.section import Picture, Section, nothing


def figure(name="time [s]"):
    drawn, axes = canvas()
    axes[0, 0].plot([0.0, 1.0], [2.0, 3.0])
    axes[0, 0].set_xlabel(name)
    return drawn


@pytest.mark.rendered
def test_the_child_makes_the_picture_that_is_made_here():
    drawn = figure()
    with Renderer() as renderer:
        found = renderer.begin(drawn).result(timeout=60)
    here, there = rendered(figure()), found
    assert there[0].startswith("<?xml") and there[1] == here[1] and there[0] == here[0]


@pytest.mark.rendered
def test_a_child_that_dies_is_done_without():
    first, second = figure("first"), figure("second")
    with Renderer() as renderer:
        renderer.end(first, renderer.begin(first))
        renderer._child.kill()
        renderer._child.wait()
        drawn, panels = renderer.end(second, renderer.begin(second))
    assert "<path" in drawn and panels[0].names[0] == "second"


@pytest.mark.rendered
def test_a_figure_that_cannot_be_sent_is_rendered_here():
    drawn = figure()
    drawn.axes[0].xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    with Renderer() as renderer:
        content, _ = renderer.end(drawn, renderer.begin(drawn))
    assert "<path" in content


@pytest.mark.rendered
def test_a_figure_that_cannot_be_drawn_says_why():
    drawn = figure("$\\notacommand$")
    with Renderer() as renderer, pytest.raises(ValueError, match="notacommand"):
        renderer.end(drawn, renderer.begin(drawn))


@pytest.mark.rendered
def test_a_section_of_a_figure_and_a_film(tmp_path):
    film = Film(lambda path: path.write_bytes(b"GIF89a"))
    pictures = [lambda: Picture("curve", "A curve.", figure()), lambda: Picture("film", "It moves.", film)]
    section = Section("key", "Title", lambda _: pictures, nothing)
    told = []
    [drawn] = draw([section], None, tmp_path / "figures", lambda done, total: told.append((done, total)))
    curve, moving = drawn.pictures
    assert told == [(1, 2), (2, 2)] and {p.name for p in (tmp_path / "figures").iterdir()} == {"curve.svg", "film.gif"}
    assert curve.source.startswith("data:image/svg+xml;base64,") and moving.source.startswith("data:image/gif;base64,")
    [panel] = json.loads(curve.panels)
    assert panel["names"] == ["time [s]", ""] and panel["x"][0] < 0.0 < 1.0 < panel["x"][1]
    assert curve.alternative == "Figure of 1 panel: time [s]." and json.loads(moving.panels) == []
