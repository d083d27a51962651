"""Layout of a wall: bays between openings, courses in each bay, and lines on which blocks meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from structid.core.errors import InputError
from structid.core.validation import check_arguments

TOLERANCE = 1e-9
"""Difference [m] below which two lengths count as equal."""


@check_arguments
@dataclass(frozen=True)
class Opening:
    """A door or a window.

    Parameters
    ----------
    left, bottom : float
        Coordinates of the lower left corner [m].
    width, height : float
        Dimensions [m].

    Examples
    --------
    >>> import structid as si
    >>> door = si.Opening(left=0.8, bottom=0.0, width=0.9, height=2.1)
    >>> door.width
    0.9
    """

    left: float
    bottom: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Right edge [m]."""
        return self.left + self.width

    @property
    def top(self) -> float:
        """Height of the lintel [m]."""
        return self.bottom + self.height

    def holds(self, x: float, y: float) -> bool:
        """Whether a point is inside.

        Parameters
        ----------
        x, y : float
            Coordinates of the point [m].

        Returns
        -------
        bool
            True inside the opening; False on its edges.
        """
        return self.left + TOLERANCE < x < self.right - TOLERANCE and self.bottom + TOLERANCE < y < self.top - TOLERANCE

    def __str__(self) -> str:
        return f"the opening from ({self.left:g}, {self.bottom:g}) to ({self.right:g}, {self.top:g}) m"


DOOR = Opening(left=1.2, bottom=0.0, width=0.9, height=1.6)
"""Door of the thesis's façade."""


class Block(NamedTuple):
    """A rectangle of masonry [m] with a name such as ``"bay 1, course 2"``."""

    left: float  # left edge
    bottom: float  # lower edge
    right: float  # right edge
    top: float  # upper edge
    name: str  # location of the block


@check_arguments
@dataclass(frozen=True)
class Wall:
    """A wall with openings, laid in courses.

    The edges and middles of the openings divide the wall into columns; sills and lintels divide it into zones. In a zone, adjacent
    columns without an opening between them form a bay. A bay has courses of equal height; a course has one block per column.

    Parameters
    ----------
    width, height, thickness : float
        Dimensions of the wall [m].
    openings : sequence of Opening
        Doors and windows; by default the door of the thesis.
    courses : sequence of int or of sequence of int, optional
        Number of courses for every zone from the bottom: one number for all bays, or one for each bay from the left. By
        default each course is `course_height` high.
    course_height : float
        Height of a course [m] if `courses` is not given; it must divide the height of every zone.
    block_length : float, optional
        Maximum length of a block [m]; longer columns are divided into equal parts.

    Examples
    --------
    >>> import structid as si
    >>> door = si.Opening(left=1.2, bottom=0.0, width=0.9, height=1.6)
    >>> facade = si.Wall(width=2.7, height=2.6, openings=(door,), courses=((4, 3), 2))
    >>> len(facade.blocks)
    15
    """

    width: float = 2.7
    height: float = 2.6
    thickness: float = 0.15
    openings: Sequence[Opening] = (DOOR,)
    courses: Sequence[int | Sequence[int]] | None = None
    course_height: float = 0.2
    block_length: float | None = None

    def __post_init__(self) -> None:
        for name in ("width", "height", "thickness", "course_height"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"Wall.{name}", f"{getattr(self, name):g}", "a positive length in metres")
        for number, opening in enumerate(self.openings):
            self._check_opening(opening, self.openings[:number])
        if self.courses is not None and len(self.courses) != len(self.zones):
            raise InputError(
                "Wall.courses",
                f"{len(self.courses)} numbers",
                f"one for each of the {len(self.zones)} zones, which end at {', '.join(f'{top:g}' for _, top in self.zones)} m",
            )
        for zone in range(len(self.zones)):
            self._courses_of(zone)

    def _check_opening(self, opening: Opening, others: Sequence[Opening]) -> None:
        if not (opening.width > 0.0 and opening.height > 0.0):
            raise InputError("Wall.openings", f"{opening}", "an opening with a positive width and height")
        inside = opening.left >= 0.0 and opening.right <= self.width and opening.bottom >= 0.0
        if not (inside and opening.top <= self.height) or opening.width >= self.width - TOLERANCE:
            cure = f"Move the opening into the wall, which is {self.width:g} m wide and {self.height:g} m high."
            raise InputError("Wall.openings", f"{opening} does not fit", "openings inside the wall", cure)
        for other in others:
            beside_each_other = opening.right <= other.left + TOLERANCE or other.right <= opening.left + TOLERANCE
            above = opening.top <= other.bottom + TOLERANCE or other.top <= opening.bottom + TOLERANCE
            if not (beside_each_other or above):
                raise InputError("Wall.openings", f"{opening} overlaps {other}", "openings that do not overlap")

    @property
    def zones(self) -> list[tuple[float, float]]:
        """Bottom and top [m] of every zone between sills and lintels, in ascending order."""
        return list(pairwise(_distinct([0.0, self.height, *(y for o in self.openings for y in (o.bottom, o.top))])))

    @property
    def columns(self) -> list[tuple[float, float]]:
        """Left and right ends [m] of the columns between edges and middles of openings, divided according to `block_length`."""
        edges = [x for o in self.openings for x in (o.left, 0.5 * (o.left + o.right), o.right)]
        lines = [0.0, self.width]
        for left, right in pairwise(_distinct([*lines, *edges])):
            parts = 1 if self.block_length is None else int(np.ceil((right - left) / self.block_length - TOLERANCE))
            lines += list(np.linspace(left, right, parts + 1))
        return list(pairwise(_distinct(lines)))

    def bays(self, zone: int) -> list[list[tuple[float, float]]]:
        """Return the bays of a zone: adjacent columns without an opening between them.

        Parameters
        ----------
        zone : int
            Index of the zone from the bottom, counted from 0.

        Returns
        -------
        list of list of tuple of float
            Columns of every bay, from left to right.
        """
        bays: list[list[tuple[float, float]]] = []
        middle, open_before = 0.5 * sum(self.zones[zone]), True
        for left, right in self.columns:
            is_open = any(opening.holds(0.5 * (left + right), middle) for opening in self.openings)
            if not is_open:
                bays = [*bays, []] if open_before else bays
                bays[-1].append((left, right))
            open_before = is_open
        return bays

    def _courses_of(self, zone: int) -> list[int]:
        """Return the number of courses in every bay of a zone."""
        (bottom, top), bays = self.zones[zone], len(self.bays(zone))
        if self.courses is None:
            count = (top - bottom) / self.course_height
            if abs(count - round(count)) > 1e-6 or round(count) < 1:
                raise InputError(
                    "Wall.course_height",
                    f"{self.course_height:g} m does not fit: the zone from {bottom:g} to {top:g} m would have {count:.2f} courses",
                    "a course height that divides the height of every zone between sills and lintels",
                    "Change the height, or give the courses of each zone: Wall(courses=((4, 3), 2)).",
                )
            return [round(count)] * bays
        given = self.courses[zone]
        numbers = [given] * bays if isinstance(given, (int, np.integer)) else list(np.atleast_1d(given))
        if len(numbers) != bays or any(not isinstance(n, (int, np.integer)) or n < 1 for n in numbers):
            allowed = f"a whole number from 1, or one for each of the {bays} bays between {bottom:g} and {top:g} m"
            raise InputError("Wall.courses", f"{given!r} in zone {zone + 1}", allowed)
        return [int(n) for n in numbers]

    @property
    def blocks(self) -> list[Block]:
        """All blocks, sorted by zone from the bottom, bay from the left, course and position."""
        blocks = []
        for zone, (bottom, top) in enumerate(self.zones):
            for bay, (columns, count) in enumerate(zip(self.bays(zone), self._courses_of(zone), strict=True), start=1):
                heights = np.linspace(bottom, top, count + 1)
                for course, (low, high) in enumerate(pairwise(heights), start=1):
                    for number, (left, right) in enumerate(columns, start=1):
                        where = f"zone {zone + 1}, bay {bay}, course {course}" + (
                            f", block {number}" if len(columns) > 1 else ""
                        )
                        blocks.append(Block(left, float(low), right, float(high), where))
        return blocks


def _distinct(values: Sequence[float]) -> list[float]:
    """Return sorted values without duplicates, up to rounding."""
    ordered = np.sort(np.array(values))
    return [float(v) for v in ordered[np.concatenate([[True], np.diff(ordered) > TOLERANCE])]]


FACADE = Wall(courses=((4, 3), 2))
"""The thesis's façade."""
