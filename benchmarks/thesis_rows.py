"""Rows for the tables and figures of the thesis, and their conversion to markdown."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import common

import structid as si


@dataclass(frozen=True)
class Row:
    """A table or figure of the thesis, compared with structid.

    Parameters
    ----------
    place : str
        Its number, such as ``"T 3.3"`` or ``"F 3.12"``.
    shows : str
        Content of the table or figure.
    printed : str
        Numbers printed in the thesis.
    published : str
        Numbers of structid by the published method.
    best : str
        Numbers of structid by its best method.
    why : str
        Reason for the difference.
    """

    place: str
    shows: str
    printed: str = "–"
    published: str = "–"
    best: str = "–"
    why: str = ""


HEADS = ("place", "content", "printed in the thesis", "structid, published method", "structid, best method", "remark")


@dataclass(frozen=True)
class Chapter:
    """A chapter of the thesis: its rows, and its pictures with their captions.

    Parameters
    ----------
    title : str
        Heading of the chapter.
    words : str
        Remarks on all rows.
    rows : tuple of Row
        In the order of the thesis.
    pictures : tuple of (str, str)
        File names without extension, and captions.
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
    """Prints the time of each part, and measures the total time."""

    def __init__(self) -> None:
        self.began = self.last = time.perf_counter()

    def __call__(self, what: str) -> float:
        """Print and return the seconds of a part."""
        now = time.perf_counter()
        seconds, self.last = now - self.last, now
        print(f"{seconds:7.1f} s  {what}", flush=True)
        return seconds


def el_centro(pga: float, duration: float = 40.0) -> si.GroundMotion:
    """El Centro 1940, filtered at 20 Hz and scaled [m/s²]; it replaces the thesis's record, which is not available."""
    return si.GroundMotion.read(common.EL_CENTRO).lowpass(20.0, order=4).trim(0.0, duration).scale_to_pga(pga)


def interval(mean: float, sd: float) -> str:
    """Format mean ± sd with two digits of the sd."""
    digits = max(0, 1 - int(f"{sd:e}".split("e")[1])) if sd > 0 else 3
    return f"{mean:.{digits}f} ± {sd:.{digits}f}"


def joined(parts: Iterable[str]) -> str:
    """Join the numbers of a cell, one per line."""
    return "<br>".join(parts)


def without_vectors(folder: Path) -> None:
    """Delete the PDF files, since the page shows PNG."""
    for file in folder.glob("*.pdf"):
        file.unlink()


def figures_folder(quick: bool) -> Path:
    """Return the folder of the pictures."""
    folder = common.documents(quick) / "figures" / "thesis"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
