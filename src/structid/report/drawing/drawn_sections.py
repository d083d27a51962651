"""Sections with drawn figures: the figure files in a folder, and the figures on a page."""

from __future__ import annotations

import base64
import json
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from structid.core.journal import write_then_rename
from structid.core.progress import Progress
from structid.figures.style import WIDTH
from structid.models.pictures import Film
from structid.report.drawing.rendering import Rendered, Renderer
from structid.report.drawing.vector import Panel
from structid.report.section import Picture, Section


@dataclass(frozen=True)
class DrawnPicture:
    """A picture on a page."""

    name: str  # file name
    caption: str  # caption
    source: str  # content of the picture, as a data URL
    alternative: str  # description for readers who cannot see the picture
    panels: str  # JSON of the panels from which values can be read; an empty list for a film
    share: float = 1.0  # width relative to a full-width figure


@dataclass(frozen=True)
class DrawnSection:
    """A section with drawn figures."""

    section: Section[Any]
    pictures: tuple[DrawnPicture, ...]  # its figures


def draw(
    sections: Sequence[Section[Any]], material: Any, folder: Path, progress: Progress | None = None
) -> list[DrawnSection]:
    """Draw all figures of the sections, and write them to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    steps = deque((section, drawing) for section in sections for drawing in section.drawings(material))
    count = len(steps)
    begun: list[tuple[str, Picture, Future[Rendered] | None]] = []
    pictures: dict[str, list[DrawnPicture]] = {section.key: [] for section in sections}
    with Renderer() as renderer:
        while steps:
            # The drawings of one observation share its predictions, which are not held longer than needed.
            section, drawing = steps.popleft()
            picture = drawing()
            waiting = None if isinstance(picture.drawn, Film) else renderer.begin(picture.drawn)
            begun.append((section.key, picture, waiting))
            if progress is not None:
                progress(count - len(steps), count)
        for key, picture, waiting in begun:
            pictures[key].append(_written(picture, waiting, renderer, folder))
    return [DrawnSection(section, tuple(pictures[section.key])) for section in sections]


def _written(picture: Picture, begun: Future[Rendered] | None, renderer: Renderer, folder: Path) -> DrawnPicture:
    """Write a picture to a folder, as SVG, or as GIF if it is an animation."""
    if begun is None or isinstance(picture.drawn, Film):
        assert isinstance(picture.drawn, Film)
        path = folder / f"{picture.name}.gif"
        picture.drawn.write(path)
        return DrawnPicture(picture.name, picture.caption, _url("gif", path.read_bytes()), picture.caption, "[]")
    content, result = renderer.end(picture.drawn, begun)
    write_then_rename(folder / f"{picture.name}.svg", content.encode())
    panels_as_text = json.dumps([asdict(panel) for panel in result])
    share = min(1.0, round(float(picture.drawn.get_figwidth()) / WIDTH, 3))
    return DrawnPicture(
        picture.name, picture.caption, _url("svg+xml", content.encode()), _in_words(result), panels_as_text, share
    )


def _url(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64," + base64.b64encode(content).decode()


def _in_words(panels: Sequence[Panel]) -> str:
    """Describe the panels of a figure by their titles and axes."""
    descriptions = dict.fromkeys(filter(None, map(_of_a_panel, panels)))
    return f"Figure of {len(panels)} panel{'s' * (len(panels) != 1)}: {'; '.join(descriptions) or 'without labels'}."


def _of_a_panel(panel: Panel) -> str:
    x, y = panel.names
    axes = f"{y} over {x}" if x and y else x or y
    return f"{panel.title}, {axes}" if panel.title and axes else panel.title or axes
