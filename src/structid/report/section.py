"""A section of a report: a title, paragraphs, tables and figures, from the data of a study."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from structid.models.pictures import Film

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = tuple[list[str], list[list[str]]]
"""Column titles and rows of a table."""

M = TypeVar("M", contravariant=True)


@dataclass(frozen=True)
class Table:
    """A table with its caption."""

    caption: str  # caption
    rows: Rows  # column titles and rows
    of_words: bool = False  # whether the cells are text, aligned left and wrapped


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure of a section."""

    name: str  # file name without extension
    caption: str  # caption
    drawn: Figure | Film  # the unsaved figure, or a film


NEAREST = "These parameters give the model's best fit to the data. They are not properties of the structure."
"""Note on the parameters of a wrong model."""

Drawing = Callable[[], Picture]
"""Function that draws one figure."""


def nothing(material: object) -> list[Any]:
    """Empty list, for a section without paragraphs, tables or figures."""
    return []


@dataclass(frozen=True, eq=False)
class Section(Generic[M]):
    """One section of a report.

    Parameters
    ----------
    key : str
        Anchor of the section in the page.
    title : str
        Heading of the section.
    drawings : callable
        Returns the functions that draw its figures; separate functions allow a progress bar.
    tables : callable
        Returns its tables.
    words : callable
        Returns its paragraphs, which precede the tables.
    under_doubt : str
        Note for the reader if the model or the error model is wrong for the data; empty if no note is needed.
    of_draws : bool
        Whether the section shows draws, which are invalid if the sampler has not converged.

    Examples
    --------
    >>> from structid.report.section import Section, Table
    >>> section = Section(
    ...     "draws",
    ...     "Number of draws",
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
