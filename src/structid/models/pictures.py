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
    """A film, which is long to draw and is written as it is drawn.

    Parameters
    ----------
    write : callable
        Writes it into a file of this name, a GIF.
    """

    write: Callable[[Path], object]


@dataclass(frozen=True)
class ModelPicture:
    """One picture.

    Parameters
    ----------
    name : str
        Of its file, without ending.
    caption : str
        What it shows.
    draw : callable
        Draws it.
    """

    name: str
    caption: str
    draw: Callable[[], Figure | Film]
