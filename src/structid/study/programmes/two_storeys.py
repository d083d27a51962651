"""Structures that a programme divides into a numerical and a physical part."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from structid.core.errors import InputError
from structid.hybrid.online.updated_springs import UpdatedSprings
from structid.hybrid.substructures.facade_parts import FloorMasses, facade_parts
from structid.hybrid.substructures.frame_parts import cut_frame
from structid.hybrid.substructures.substructure import Substructure
from structid.mechanics.carried_over import CarriedOver
from structid.mechanics.restoring_forces import HystereticSprings, RestoringForce
from structid.models import model_list
from structid.models.base import Model
from structid.models.hysteretic.shear_frame import ShearFrame
from structid.models.masonry.equations.static_wall import BEAM
from structid.models.masonry.masonry_wall import MasonryWall
from structid.models.traceable import as_traceable
from structid.study.building.models import true_model
from structid.study.building.named_kind import kind_named
from structid.study.programmes.programme_file import FacadeTable, ShearFrameTable
from structid.study.schema.static_tables import ModelTable


def moved_model(section: ModelTable, folder: Path) -> Model:
    """Build a model without free parameters, on which displacements can be imposed."""
    return true_model(section, moved_channels(section), folder)


def moved_channels(section: ModelTable) -> tuple[str, ...]:
    """Names of the channels with which a model for imposed displacements is built."""
    return (kind_named(section.type, model_list.MODELS).moved_channel,)


def force_of(model: Model, dofs: int) -> RestoringForce:
    """Restoring force of a model without free parameters."""
    force = as_traceable(model, "key 'specimen.model'").static_force(np.zeros((1, 0)))
    if force is None or force.dofs != dofs:
        came = f"a {model.kind_in_words}" + ("" if force is None else f" with {force.dofs} imposed displacements")
        raise InputError(
            "key 'specimen.model'", came, f"a model with {dofs} imposed displacements", "Match it to [structure]."
        )
    return force


class CutStructure(ABC):
    """A structure divided into two parts."""

    alike: UpdatedSprings | None = None  # springs of the numerical part that adopt the specimen's parameters
    channels: tuple[str, ...]  # channels of the specimen
    units: tuple[str, ...]  # units of the channels

    @abstractmethod
    def parts(self, modes: int) -> tuple[Substructure, Substructure]:
        """Return the numerical and the physical part."""


@dataclass(frozen=True)
class CutFrame(CutStructure):
    """A shear frame, divided above its lowest storey."""

    section: ShearFrameTable  # content of the file
    expected: Model  # expected specimen
    # Springs of the upper storeys, which adopt the estimated parameters of the specimen, if online.update is true
    alike: UpdatedSprings | None = None
    channels = ("drift",)
    units = ("m",)

    def parts(self, modes: int) -> tuple[Substructure, Substructure]:
        """Return the numerical and the physical part; see `CutStructure.parts`."""
        given = self.section
        frame = ShearFrame(
            storeys=given.storeys,
            mass=given.mass,
            stiffness=given.stiffness,
            damping_ratio=given.damping_ratio,
            alpha=1.0,
            beta=0.0,
            gamma=0.0,
        )
        upper, lower = cut_frame(frame, 1, interface_share=given.share, linear=True)
        largest = np.array([[given.largest_stiffness or given.stiffness]])
        if self.alike is not None:
            factor = (given.largest_stiffness or given.stiffness) / given.stiffness
            upper = replace(upper, stiffness=factor * upper.stiffness, restoring_force=self.alike)
        return upper, replace(lower, stiffness=largest, restoring_force=force_of(self.expected, 1))


@dataclass(frozen=True)
class CutFacade(CutStructure):
    """A facade of two storeys, divided between them."""

    section: FacadeTable  # content of the file
    expected: Model  # expected specimen
    folder: Path  # base of relative paths
    channels = ("u_x", "u_y", "theta")
    units = ("m", "m", "rad")

    def parts(self, modes: int) -> tuple[Substructure, Substructure]:
        """Return the numerical and the physical part; see `CutStructure.parts`."""
        given = self.section
        wall = cast(MasonryWall, moved_model(given.wall, self.folder))  # the schema allows only a masonry wall
        cut = facade_parts(wall, modes=modes, masses=FloorMasses(given.floor_mass, given.roof_mass))
        expected = CarriedOver(force_of(self.expected, BEAM), np.zeros((1, BEAM)))
        return cut.upper, replace(
            cut.lower, stiffness=given.stiffness_margin * cut.lower.stiffness, restoring_force=expected
        )


def built_alike(section: ShearFrameTable, specimen: RestoringForce) -> UpdatedSprings:
    """Build springs for the upper storeys with the hysteretic model of the specimen."""
    if not isinstance(specimen, HystereticSprings):
        raise InputError("key 'online.update'", "true for a specimen that is not a spring", "false, or a spring model")
    count = section.storeys - 1
    between = np.eye(count, section.storeys, k=1) - np.eye(count, section.storeys)
    stiffness, mass = (np.full(count, float(value[0])) for value in (specimen.stiffness, specimen.mass))
    return UpdatedSprings(HystereticSprings(between, stiffness, mass, specimen.law))


def cut_structure(
    section: ShearFrameTable | FacadeTable, expected: ModelTable, folder: Path, alike: bool = False
) -> CutStructure:
    """Build the divided structure of a programme."""
    if isinstance(section, ShearFrameTable):
        model = moved_model(expected, folder)
        return CutFrame(section, model, built_alike(section, force_of(model, 1)) if alike else None)
    if alike:
        raise InputError("key 'online.update'", "true for a facade, whose upper storey stays linear", "false")
    return CutFacade(section, moved_model(expected, folder), folder)
