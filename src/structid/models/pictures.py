"""Pictures of a structure in motion that a model can draw of itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Film:
    """A film, which is long to draw and is written as it is drawn."""

    write: Callable[[Path], object]  # Writes it into a file of this name, a GIF


@dataclass(frozen=True)
class ModelPicture:
    """One picture."""

    name: str  # Of its file, without ending
    caption: str  # What it shows
    draw: Callable[[], Figure | Film]  # Draws it
