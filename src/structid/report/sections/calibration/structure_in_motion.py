"""Animations and pictures of the structure, drawn by the model at the MAP estimate."""

from __future__ import annotations

import functools

from structid.models.pictures import ModelPicture
from structid.report.material.material import PosteriorMaterial
from structid.report.section import NEAREST, Drawing, Picture, Section, nothing


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    model = material.true_posterior.model
    theta = material.best[: material.true_posterior.model_space.dimension]
    record = material.observations[0].record
    return [functools.partial(_drawn, picture) for picture in model.pictures(theta, record)]


def _drawn(picture: ModelPicture) -> Picture:
    return Picture(picture.name, picture.caption, picture.draw())


SECTION = Section("structure-in-motion", "The structure in motion", _drawings, nothing, under_doubt=NEAREST)
"""Pictures at the MAP estimate, for the first measured record."""
