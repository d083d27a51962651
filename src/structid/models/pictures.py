"""Pictures of the moving structure that a model can draw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Film:
    """A film. Its frames are drawn only when the file is written, because drawing takes long."""

    write: Callable[[Path], object]  # function that writes a GIF file of this name


@dataclass(frozen=True)
class ModelPicture:
    """A picture of a model."""

    name: str  # file name without extension
    caption: str  # caption
    draw: Callable[[], Figure | Film]  # function that draws it
