"""What the pages of the thesis share: one row for each of its tables and figures, and how rows become markdown."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import common

import structid as si


@dataclass(frozen=True)
class Row:
    """A table or a figure of the thesis beside ours.

    Parameters
    ----------
    place : str
        Its number, such as ``"T 3.3"`` or ``"F 3.12"``.
    shows : str
        What it is.
    printed : str
        The thesis's numbers.
    published : str
        Ours by the method as published.
    best : str
        Ours by the best method that we have.
    why : str
        Why they differ.
    """

    place: str
    shows: str
    printed: str = "–"
    published: str = "–"
    best: str = "–"
    why: str = ""


HEADS = ("", "what it shows", "printed", "as published, with structid", "best, with structid", "why they differ")


@dataclass(frozen=True)
class Chapter:
    """A chapter of the thesis: its rows, and its pictures with their captions.

    Parameters
    ----------
    title : str
        Its heading.
    words : str
        What holds for all of its rows.
    rows : tuple of Row
        In the order of the thesis.
    pictures : tuple of (str, str)
        Names of files without ending, and captions.
    """

    title: str
    words: str
    rows: tuple[Row, ...]
    pictures: tuple[tuple[str, str], ...]

    def text(self) -> str:
        """The chapter in markdown."""
        cells = [HEADS, *((r.place, r.shows, r.printed, r.published, r.best, r.why) for r in self.rows)]
        ruler = ("---",) * len(HEADS)
        lines = (cells[0], ruler, *cells[1:])
        table = "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines)
        drawn = "\n\n".join(f"![{caption}](figures/thesis/{name}.png)\n\n{caption}" for name, caption in self.pictures)
        return f"## {self.title}\n\n{self.words}\n\n{table}\n\n{drawn}\n"


class Clock:
    """Says how long each part takes, and in all."""

    def __init__(self) -> None:
        self.began = self.last = time.perf_counter()

    def __call__(self, what: str) -> float:
        """Print a part's seconds, and give them."""
        now = time.perf_counter()
        seconds, self.last = now - self.last, now
        print(f"{seconds:7.1f} s  {what}", flush=True)
        return seconds


def el_centro(pga: float, duration: float = 40.0) -> si.GroundMotion:
    """El Centro 1940 in place of the thesis's record, which is not to be had: filtered at 20 Hz, scaled [m/s²]."""
    return si.GroundMotion.read(common.EL_CENTRO).lowpass(20.0, order=4).trim(0.0, duration).scale_to_pga(pga)


def interval(mean: float, sd: float) -> str:
    """Mean ± sd, with two digits of the sd."""
    digits = max(0, 1 - int(f"{sd:e}".split("e")[1])) if sd > 0 else 3
    return f"{mean:.{digits}f} ± {sd:.{digits}f}"


def joined(parts: Iterable[str]) -> str:
    """Cells of several numbers: one a line."""
    return "<br>".join(parts)


def without_vectors(folder: Path) -> None:
    """Leave the pictures alone: a page shows PNG."""
    for file in folder.glob("*.pdf"):
        file.unlink()


def figures_folder(quick: bool) -> Path:
    """Where pictures go."""
    folder = common.documents(quick) / "figures" / "thesis"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
