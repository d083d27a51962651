"""Sections with their figures drawn: files in a folder, and what a page takes of them."""

from __future__ import annotations

import base64
import json
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
    """A picture as a page takes it."""

    name: str  # Of its file, and what it shows
    caption: str  # Of its file, and what it shows
    source: str  # The picture itself, as a data URL
    alternative: str  # What there is to see, for somebody who does not see it
    panels: str  # JSON of the panels from which values can be read off; an empty list for a film
    share: float = 1.0  # Of a full figure's width


@dataclass(frozen=True)
class DrawnSection:
    """A section whose figures have been drawn."""

    section: Section[Any]
    pictures: tuple[DrawnPicture, ...]  # Its figures


def draw(
    sections: Sequence[Section[Any]], material: Any, folder: Path, progress: Progress | None = None
) -> list[DrawnSection]:
    """Draw all figures of some sections."""
    folder.mkdir(parents=True, exist_ok=True)
    steps = [(section, drawing) for section in sections for drawing in section.drawings(material)]
    begun: list[tuple[str, Picture, Future[Rendered] | None]] = []
    pictures: dict[str, list[DrawnPicture]] = {section.key: [] for section in sections}
    with Renderer() as renderer:
        for done, (section, drawing) in enumerate(steps, start=1):
            picture = drawing()
            waiting = None if isinstance(picture.drawn, Film) else renderer.begin(picture.drawn)
            begun.append((section.key, picture, waiting))
            if progress is not None:
                progress(done, len(steps))
        for key, picture, waiting in begun:
            pictures[key].append(_written(picture, waiting, renderer, folder))
    return [DrawnSection(section, tuple(pictures[section.key])) for section in sections]


def _written(picture: Picture, begun: Future[Rendered] | None, renderer: Renderer, folder: Path) -> DrawnPicture:
    """Write a picture into a folder, as SVG, or as GIF if it is a film."""
    if begun is None or isinstance(picture.drawn, Film):
        assert isinstance(picture.drawn, Film)
        path = folder / f"{picture.name}.gif"
        picture.drawn.write(path)
        return DrawnPicture(picture.name, picture.caption, _url("gif", path.read_bytes()), picture.caption, "[]")
    content, found = renderer.end(picture.drawn, begun)
    write_then_rename(folder / f"{picture.name}.svg", content.encode())
    told = json.dumps([asdict(panel) for panel in found])
    share = min(1.0, round(float(picture.drawn.get_figwidth()) / WIDTH, 3))
    return DrawnPicture(picture.name, picture.caption, _url("svg+xml", content.encode()), _in_words(found), told, share)


def _url(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64," + base64.b64encode(content).decode()


def _in_words(found: Sequence[Panel]) -> str:
    """What the panels of a figure show: what over what."""
    said = dict.fromkeys(filter(None, map(_of_a_panel, found)))
    return f"Figure of {len(found)} panel{'s' * (len(found) != 1)}: {'; '.join(said) or 'without names'}."


def _of_a_panel(panel: Panel) -> str:
    x, y = panel.names
    axes = f"{y} over {x}" if x and y else x or y
    return f"{panel.title}, {axes}" if panel.title and axes else panel.title or axes
