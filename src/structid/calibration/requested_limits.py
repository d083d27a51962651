"""The limits that a stored calibration's certificates were asked to meet: to ask again with others is a further look."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from structid.certification.limits import Limits
from structid.core.journal import write_then_rename

FILE = "limits.json"
"""All limits, in the order in which they were asked for."""


def earlier_limits(folder: Path | None, limits: Limits) -> int:
    """Count the other limits that were asked for before these, and remember these.

    A certificate that is refused, and then granted with limits that were relaxed, was looked at twice.
    """
    if folder is None:
        return 0
    path, asked = folder / FILE, asdict(limits)
    known = json.loads(path.read_text()) if path.is_file() else []
    if asked not in known:
        known.append(asked)
        folder.mkdir(parents=True, exist_ok=True)
        write_then_rename(path, json.dumps(known, indent=2).encode())
    return int(known.index(asked))
