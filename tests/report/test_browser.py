"""A report in a real browser: wide and narrow, light and dark, its viewer, and on paper. Skipped where there is no Chromium."""

import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from structid.figures.style import canvas, name_axes
from structid.report.drawing.drawn_sections import draw
from structid.report.material.learnt_parameters import LearntParameter
from structid.report.page import template
from structid.report.page_summary import Believed, PageSummary
from structid.report.section import Picture, Section, Table

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium (apt-get install chromium)")

PROBE = """<script>
addEventListener("load", () => {
  const told = {};
  const root = document.documentElement;
  told.width = innerWidth;
  told.sideways = root.scrollWidth - innerWidth;
  told.cut = [...document.querySelectorAll("td, th")].filter((cell) => cell.scrollWidth > cell.clientWidth + 1).length;
  told.scrolling = [...document.querySelectorAll(".wide")].filter((box) => box.scrollWidth > box.clientWidth + 1).length;
  told.dead = [...document.links].filter((a) => !(a.hash && document.getElementById(a.hash.slice(1)))).map((a) => a.href)
    .filter((href) => !href.startsWith("data:"));
  told.silent = [...document.images].filter((image) => !image.alt && !image.closest("dialog")).length;
  told.page = getComputedStyle(document.body).backgroundColor;
  const figure = document.querySelector("figure img");
  told.shown = figure.naturalWidth;
  figure.click();
  const viewer = document.querySelector("dialog"), image = viewer.querySelector("img"), stage = viewer.querySelector(".stage");
  told.open = viewer.open;
  setTimeout(() => {
    const panel = JSON.parse(figure.dataset.panels)[0], before = image.getBoundingClientRect();
    const at = { clientX: before.x + before.width * (panel.left + panel.width / 2),
                 clientY: before.y + before.height * (panel.top + panel.height / 2), pointerId: 1, bubbles: true };
    stage.dispatchEvent(new PointerEvent("pointermove", at));
    told.read = viewer.querySelector(".read").textContent;
    told.middle = [(panel.x[0] + panel.x[1]) / 2, (panel.y[0] + panel.y[1]) / 2];
    viewer.querySelector("[data-zoom]").click();
    told.zoomed = image.getBoundingClientRect().width / before.width;
    viewer.querySelector("[data-close]").click();
    told.closed = !viewer.open;
    parent.postMessage(JSON.stringify(told), "*");
  }, 500);
});
</script>"""


def _figure():
    figure, axes = canvas()
    time = np.linspace(0.0, 40.0, 4001)
    axes[0, 0].plot(time, np.sin(time))
    name_axes(axes[0, 0], ("time", "s"), ("velocity", "mm/s"))
    return figure


@pytest.fixture(scope="module")
def page(tmp_path_factory, pictures):
    """A page with a summary, a wide table, words and a figure, as a study's own is put together."""
    folder = tmp_path_factory.mktemp("page")
    heads = [f"a rather long head {k}" for k in range(9)]
    table = Table("Wide", (heads, [[f"{k}.123 ± 0.004" for k in range(9)] for _ in range(3)]))
    section = Section(
        "wide", "A wide table", lambda _: [lambda: Picture("sine", "A sine.", _figure())], lambda _: [table]
    )
    with pictures.rendering(()):
        [drawn] = draw([section], None, folder / "figures")
    learnt = LearntParameter("stiffness", "kN/mm", 7.6, 0.01, (7.58, 7.62), (7.4, 7.9), (6.0, 9.0), 7.61)
    found = PageSummary([learnt], [Believed("Model", "bad", "wrong for these data")], ["Little."], ["Look."])
    content = template("base.html").environment.from_string(
        '{% extends "base.html" %}{% from "macros.html" import contents, page_summary, sections_of %}'
        "{% block content %}{{ contents([], sections) }}{{ page_summary(found) }}{{ sections_of(sections) }}{% endblock %}"
    )
    shown = {"key": "wide", "title": "A wide table", "words": ["Words."], "tables": [table], "under_doubt": ""}
    text = content.render(
        title="A structure",
        sentence="One parameter.",
        found=found,
        sections=[shown | {"pictures": drawn.pictures}],
        run=(["what", "value"], [[LONG, "structid"]]),
        settings="[model]\n" + "x" * 300,
    )
    (folder / "plain.html").write_text(text)
    (folder / "probed.html").write_text(text.replace("</body>", PROBE + "</body>"))
    return folder


LONG = "what stands in a first column may be long, and may not be written over the next one"

FRAME = """<iframe src="probed.html" style="width: {width}px; height: 900px; border: 0"></iframe><pre id="told"></pre>
<script>addEventListener("message", (event) => {{ document.getElementById("told").textContent = event.data; }});</script>"""
"""A window has a least width, which a telephone's is below; a frame has none."""


def browse(*arguments):
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=5000", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


def told(page, width, *arguments):
    frame = page / f"frame_{width}.html"
    frame.write_text(FRAME.format(width=width))
    dom = browse("--window-size=1600,1000", *arguments, "--dump-dom", f"file://{frame}")
    found = re.search(r'<pre id="told">(.*?)</pre>', dom, re.DOTALL)
    assert found and found[1], dom[-2000:]
    return json.loads(html.unescape(found[1]))


@pytest.mark.parametrize("width", [1400, 400])
def test_nothing_is_cut_and_only_wide_tables_scroll(page, width):
    found = told(page, width)
    assert found["width"] == width and found["sideways"] <= 0, found
    assert found["cut"] == 0 and found["dead"] == [] and found["silent"] == 0 and found["shown"] > 100, found
    assert found["scrolling"] >= 1  # nine columns are too many for any page


@pytest.mark.parametrize("width", [1400, 400])
def test_a_figure_is_opened_zoomed_and_read_off(page, width):
    found = told(page, width)
    assert found["open"] and found["closed"] and found["zoomed"] == pytest.approx(1.5, rel=1e-3)
    x, y = (float(part) for part in re.findall(r": (-?[\d.e-]+)", found["read"]))
    assert "time [s]" in found["read"] and "velocity [mm/s]" in found["read"]
    assert x == pytest.approx(found["middle"][0], abs=0.1) and y == pytest.approx(found["middle"][1], abs=0.02)


def test_light_and_dark(page):
    light = told(page, 1400)["page"]
    dark = told(page, 1400, "--blink-settings=preferredColorScheme=0")["page"]
    assert light == "rgb(255, 255, 255)" and max(map(int, re.findall(r"\d+", dark))) < 60


def test_on_paper_it_is_a4(page):
    target = page / "page.pdf"
    browse("--no-pdf-header-footer", f"--print-to-pdf={target}", f"file://{page / 'plain.html'}")
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", target.read_bytes())
    assert boxes and all(abs(float(w) - 595.3) < 2 and abs(float(h) - 841.9) < 2 for w, h in boxes), boxes
