"""The model runs: status counts and responses."""

from __future__ import annotations

import functools

import numpy as np

from structid.campaign.runs import Runs
from structid.report.material.material import RunsMaterial
from structid.report.section import Drawing, Picture, Rows, Section, Table


def _how_they_ended(runs: Runs) -> Rows:
    """Counts of the runs by status, their cost, and the reasons of failures."""
    rows = [[status.words, f"{count}", ""] for status, count in runs.counts.items() if count]
    seconds = runs.seconds[np.isfinite(runs.seconds) & (runs.seconds > 0)]
    if seconds.size:
        rows.append(["wall time of a run", f"{np.median(seconds):.3g} s", f"median; {seconds.max():.3g} s at most"])
    again = int((runs.attempts > 1).sum())
    if again:
        rows.append(["more than one attempt", f"{again}", ""])
    rows += [["reason of failure", f"{count}", reason] for reason, count in runs.failures[:20]]
    return ["status", "runs", ""], rows


def _tables(material: RunsMaterial) -> list[Table]:
    return [] if material.runs is None else [Table("Status of the runs", _how_they_ended(material.runs), of_words=True)]


def _drawings(material: RunsMaterial) -> list[Drawing]:
    return [] if material.runs is None else [functools.partial(_overview, material.runs)]


def _overview(runs: Runs) -> Picture:
    return Picture(
        "runs",
        "Left: responses over the design; at each time, the bands contain 50 and 90 % of the runs. Right: the design.",
        runs.plot(),
    )


SECTION = Section("model-runs", "Model runs", _drawings, _tables)
