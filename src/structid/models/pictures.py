"""Pictures of a structure in motion that a model can draw of itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


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
        Draws it into a file whose name without ending is given: PNG and PDF, or a GIF.
    is_film : bool
        Whether it is a GIF.
    """

    name: str
    caption: str
    draw: Callable[[Path], object]
    is_film: bool = False
