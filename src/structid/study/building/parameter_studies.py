"""The parameter study of a study file: points, limits and the part of the box examined separately, in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from structid.core.errors import check_choice
from structid.core.units import to_si
from structid.models.base import Model
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace
from structid.study.schema.study_file import StudyFile


@dataclass(frozen=True)
class PlannedParameterStudy:
    """Settings of a parameter study."""

    design: Design  # points
    model: Model  # the study's model with the required channels
    channel: str  # channel of the passages
    limits: tuple[float, ...]  # in SI
    above: Mapping[str, float]  # lower bounds [SI] of the part of the box examined separately
    peaks: tuple[str, ...]  # channels whose peaks are explained


def planned_parameter_study(file: StudyFile, space: ParameterSpace, model: Model) -> PlannedParameterStudy | None:
    """Plan the parameter study of a file."""
    section = file.parameter_study
    if section is None:
        return None
    design = space.sample(section.runs, file.seed if section.seed is None else section.seed, section.method)
    recording = model.recording(*dict.fromkeys((section.channel, *section.peaks)))
    limits = tuple(limit_of(limit, section.channel, recording, "parameter_study.limits") for limit in section.limits)
    for name in section.above:
        check_choice("table 'parameter_study.above'", name, space.names)
    above = {n: to_si(v, space.units[n], f"key 'parameter_study.above.{n}'") for n, v in section.above.items()}
    return PlannedParameterStudy(design, recording, section.channel, limits, above, section.peaks)


def limit_of(limit: float | str, channel: str, model: Model, where: str) -> float:
    """Read a limit of a channel."""
    return to_si(limit, model.channel_units[channel].si, f"key '{where}'")
