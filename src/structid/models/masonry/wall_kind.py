"""Masonry walls in a study file."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from structid.core.errors import InputError
from structid.core.keys import FileTable, Fraction, Seconds, quantity
from structid.models.masonry.finite_elements.assembly import Masonry
from structid.models.masonry.finite_elements.layout import DOOR, FACADE, Opening, Wall
from structid.models.masonry.masonry_wall import MasonryWall
from structid.models.masonry.wall_parameters import PARAMETER_UNITS
from structid.models.model_kind import ModelKind, ModelRequest

Metres: Any = quantity("m")


class OpeningTable(FileTable):
    """A door or a window; see `Opening`."""

    left: Metres
    bottom: Metres = 0.0
    width: Metres
    height: Metres


WALL_KEYS: dict[str, tuple[Any, Any]] = {
    "width": (Metres, 2.7),
    "height": (Metres, 2.6),
    "thickness": (Metres, 0.15),
    "openings": (tuple[OpeningTable, ...], None),
    "courses": (tuple[int | tuple[int, ...], ...], None),
    "course_height": (Metres, None),
    "block_length": (Metres, None),
}
"""Keys of `Wall`. The default openings and courses are those of the façade in the thesis."""

MASONRY_KEYS: dict[str, tuple[Any, Any]] = {
    "modulus": (quantity("Pa"), 4.21e9),
    "poisson": (Fraction, 0.2),
    "density": (quantity("kg/m^3"), 1000.0),
    "steel_modulus": (quantity("Pa"), 210e9),
    "steel_area": (quantity("m^2"), 0.01),
    "vertical_load": (quantity("N"), 208e3),
    "upper_mass": (quantity("kg"), 12_000.0),
}
"""Keys of `Masonry`."""


def _wall(given: dict[str, Any]) -> Wall:
    sections = given.get("openings")
    openings = (DOOR,) if sections is None else tuple(Opening(**section) for section in sections)
    size = {name: given[name] for name in ("width", "height", "thickness")}
    if given.get("courses") is not None and given.get("course_height") is not None:
        raise InputError("keys 'courses' and 'course_height'", "both are given", "only one of the two", "Remove one.")
    if given.get("course_height") is not None:
        size["course_height"] = given["course_height"]
    other_wall = sections is not None or given.get("course_height") is not None
    courses = given.get("courses", None if other_wall else FACADE.courses)
    return Wall(**size, openings=openings, courses=courses, block_length=given.get("block_length"))


def _built(asked: ModelRequest) -> MasonryWall:
    given = dict(asked.given)
    masonry = Masonry(**{name: given.pop(name) for name in MASONRY_KEYS})
    wall = _wall({name: given.pop(name) for name in WALL_KEYS if name in given})
    return MasonryWall(wall=wall, masonry=masonry, free=asked.free, channels=asked.channels, **given)


KIND = ModelKind(
    word="masonry_wall",
    keys={
        **{name: (quantity(unit), None) for name, unit in PARAMETER_UNITS.items()},
        **WALL_KEYS,
        **MASONRY_KEYS,
        "joint_law": (Literal["smc-np2", "damage-friction"], "smc-np2"),
        "characteristic_length": (Literal["exponential", "xu-needleman"], "exponential"),
        "joint_points": (Literal["ends", "gauss"], "ends"),
        "base_joint": (bool, False),
        "step": (Seconds, Field(default=1e-3, gt=0)),
    },
    build=_built,
    parameters=lambda given: PARAMETER_UNITS,
    parameter_unit=lambda name, given, unknown: PARAMETER_UNITS.get(name),
    moved_channel="drift",
)
