"""Pictures that a model can draw of the structure in motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Film:
    """A film, drawn while it is written because that takes long."""

    write: Callable[[Path], object]  # writes a GIF file of this name


@dataclass(frozen=True)
class ModelPicture:
    """One picture."""

    name: str  # file name without extension
    caption: str  # caption
    draw: Callable[[], Figure | Film]  # draws it
