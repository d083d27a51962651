"""The measured loop from which a study derives priors."""

from __future__ import annotations

from pathlib import Path

from structid.core.errors import within
from structid.models.hysteretic.loop_lines import LoopLines
from structid.study.schema.static_tables import LoopTable


def build_loop(section: LoopTable | None, folder: Path) -> LoopLines | None:
    """Fit two lines to the measured loop of a study; None without a loop."""
    if section is None:
        return None
    settings = section.model_dump(exclude={"file"})
    with within("table 'loop'"):
        return LoopLines.read(folder / section.file, **settings)
