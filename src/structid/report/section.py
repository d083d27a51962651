"""A section of a report: a title, words, tables and figures, made from a study's data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from structid.models.pictures import Film

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = tuple[list[str], list[list[str]]]
"""Titles and rows of a table."""

M = TypeVar("M", contravariant=True)


@dataclass(frozen=True)
class Table:
    """A table with its caption."""

    caption: str  # caption
    rows: Rows  # titles and rows
    of_words: bool = False  # whether its cells are words, aligned left and wrapped


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure of a section."""

    name: str  # file name without extension
    caption: str  # caption
    drawn: Figure | Film  # the unsaved figure, or a film


NEAREST = "These are the parameters with which the model comes nearest to the data, not those of the structure."
"""Note on parameters of a wrong model."""

Drawing = Callable[[], Picture]
"""Draws one figure."""


def nothing(material: object) -> list[Any]:
    """Words or tables of a section without any."""
    return []


@dataclass(frozen=True, eq=False)
class Section(Generic[M]):
    """One section of a report.

    Parameters
    ----------
    key : str
        Of its anchor in the page.
    title : str
        Its heading.
    drawings : callable
        Its figures, of what the study has left; each is drawn by itself, so that progress can be shown.
    tables : callable
        Its tables.
    words : callable
        Its paragraphs, before the tables.
    under_doubt : str
        What the reader must know here where model or error model are wrong for the data; empty where this does not matter.
    of_draws : bool
        Whether it shows draws, which are worth nothing where the sampler has not converged.

    Examples
    --------
    >>> from structid.report.section import Section, Table
    >>> section = Section(
    ...     "draws",
    ...     "How many draws there are",
    ...     drawings=lambda material: [],
    ...     tables=lambda material: [Table("Draws", (["count"], [[str(len(material.result.flat))]]))],
    ... )
    >>> section.key
    'draws'
    """

    key: str
    title: str
    drawings: Callable[[M], Sequence[Drawing]]
    tables: Callable[[M], Sequence[Table]]
    words: Callable[[M], Sequence[str]] = nothing
    under_doubt: str = ""
    of_draws: bool = True
