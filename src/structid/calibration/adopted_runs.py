"""Restart of a stored calibration with the model runs of another version of the model.

A user may correct a solver whose completed runs remain valid. Rounds, surrogates and draws belong to the old version and are
removed. The runs themselves are kept, and become the first design of the new version's calibration.
"""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import numpy as np
from jaxtyping import Float

from structid.calibration.requested_limits import FILE as ASKED_LIMITS
from structid.campaign.parts import parts_of
from structid.campaign.store import CALIBRATION_RUNS, open_runs
from structid.certification.model_runs import ModelRuns
from structid.core.errors import StoreMismatchError
from structid.core.journal import write_then_rename

FIRST_DESIGN = "first_design.npy"
"""Name of the file with the first points of a calibration, if they differ from the planned points."""


def first_design(
    folder: Path | None, planned: Float[np.ndarray, "point parameter"]
) -> Float[np.ndarray, "first_point parameter"]:
    """Points with which a calibration begins."""
    if folder is None or not (folder / FIRST_DESIGN).is_file():
        return planned
    return np.asarray(np.load(folder / FIRST_DESIGN))


def take_over(true: ModelRuns) -> None:
    """Restart a stored calibration with its stored runs if they come from another version of the model."""
    folder = true.folder
    if folder is None or not _of_another_model(true):
        return
    stored = open_runs(folder / CALIBRATION_RUNS).design.values
    points = stored[:: len(true.records)]
    true.adopt()
    content = io.BytesIO()
    np.save(content, points)
    write_then_rename(folder / FIRST_DESIGN, content.getvalue())
    kept = {CALIBRATION_RUNS, parts_of(Path(CALIBRATION_RUNS)).name, FIRST_DESIGN, ASKED_LIMITS}
    for entry in folder.iterdir():
        if entry.name in kept:
            continue
        if entry.is_dir():
            shutil.rmtree(entry)
        else:
            entry.unlink()
    true.points = points


def _of_another_model(true: ModelRuns) -> bool:
    try:
        true.refuse_another()
    except StoreMismatchError:
        return True
    return False
