"""Record of the limits requested for a stored calibration, since a change of the limits counts as a further attempt."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from structid.certification.limits import Limits
from structid.core.journal import write_then_rename

FILE = "limits.json"
"""Name of the file with all requested limits, in the order of the requests."""


def earlier_limits(folder: Path | None, limits: Limits) -> int:
    """Count the different limits requested earlier, and store the given limits.

    A certificate that is refused, and then issued with relaxed limits, took two attempts.
    """
    if folder is None:
        return 0
    path, requested = folder / FILE, asdict(limits)
    limits_requested = json.loads(path.read_text()) if path.is_file() else []
    if requested not in limits_requested:
        limits_requested.append(requested)
        folder.mkdir(parents=True, exist_ok=True)
        write_then_rename(path, json.dumps(limits_requested, indent=2).encode())
    return int(limits_requested.index(requested))
