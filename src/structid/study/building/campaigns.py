"""The model runs of a study: their parameter values and their records."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.ground_motion.record import GroundMotion
from structid.probability.designs import Design
from structid.probability.space import ParameterSpace
from structid.study.building.named_kind import kind_named
from structid.study.building.records import load_record
from structid.study.schema.static_tables import CampaignTable
from structid.study.schema.study_file import StudyFile
from structid.surrogates import surrogate_list as registry

SURROGATE_RUNS = 500
"""Default number of model runs of a study with a surrogate."""

SURROGATE_WIDENING = 2.0
"""Ratio of the width of a surrogate's design to the prior's width, in standard-normal coordinates."""


def build_campaign(
    file: StudyFile, folder: Path, space: ParameterSpace, driven_by: tuple[GroundMotion, ...]
) -> tuple[Design | None, tuple[GroundMotion, ...]]:
    """Draw the design of model runs, and read its records; for a surrogate, they include the records of all observations."""
    section, kind = file.campaign, file.surrogate.kind
    if file.calibration is not None or (section is None and kind == "none"):
        return None, ()
    section = section or CampaignTable(runs=SURROGATE_RUNS)
    seed = file.seed if section.seed is None else section.seed
    further = [load_record(r, folder, f"campaign.records.{i}") for i, r in enumerate(section.records, start=1)]
    # The training design of a surrogate extends further into the tails than the prior.
    widen = section.widen or (1.0 if kind == "none" else SURROGATE_WIDENING)
    design = space.sample(section.runs, seed, section.method, widen)
    records = (*(driven_by[:1] if kind == "none" else driven_by), *further)
    if kind != "none" and kind_named(kind, registry.KINDS).own_records:  # every point with every record
        design = Design(np.repeat(design.values, len(records), axis=0), space)
    return design, records
