"""The fragility of a study: its records, levels and limit in SI."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from structid.core.errors import InputError
from structid.ground_motion.record import GroundMotion
from structid.models.base import Model
from structid.study.building.parameter_studies import limit_of
from structid.study.building.records import load_record
from structid.study.schema.study_file import StudyFile


@dataclass(frozen=True)
class PlannedFragility:
    """Settings of a fragility."""

    records: tuple[GroundMotion, ...]  # ground motions
    levels: tuple[float, ...]  # peak ground accelerations [m/s²] to which they are scaled
    channel: str  # channel whose absolute value passes the limit
    limit: float  # in SI
    draws: int  # number of posterior draws
    surrogate: bool  # whether a surrogate replaces the model at most draws
    training: int  # number of draws to which it is fitted
    checks: int  # number of draws that correct it


def planned_fragility(file: StudyFile, folder: Path, model: Model) -> PlannedFragility | None:
    """Plan the fragility of a file."""
    section = file.fragility
    if section is None:
        return None
    if not file.observation:
        raise InputError("table 'fragility'", "no [observation]", "a measurement, given which the probability is")
    records = tuple(load_record(r, folder, f"fragility.records.{i}") for i, r in enumerate(section.records, start=1))
    recording = model.recording(section.channel)
    stands_in = not model.batched if section.surrogate is None else section.surrogate
    needed = section.training + section.checks + 1
    if stands_in and section.draws < needed:
        raise InputError(
            "key 'fragility.draws'", f"{section.draws}, with a surrogate that takes {needed - 1}", f"{needed} or more"
        )
    return PlannedFragility(
        records,
        section.pga,
        section.channel,
        limit_of(section.limit, section.channel, recording, "fragility.limit"),
        section.draws,
        stands_in,
        section.training,
        section.checks,
    )
