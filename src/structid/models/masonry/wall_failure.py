"""Causes of an early end of a run of a wall: no equilibrium of the joints, or a joint without support."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.core.errors import Status
from structid.histories import Histories
from structid.models.masonry.finite_elements.mesh import Mesh


def with_rows(all_runs: Histories, rows: np.ndarray, again: Histories) -> Histories:
    """Replace each run by its repetition with shorter steps, if the repetition reaches a later time."""
    further = again.done | (np.nan_to_num(again.failure_time) > all_runs.failure_time[rows])
    values, status, time = all_runs.values.copy(), all_runs.status.copy(), all_runs.failure_time.copy()
    reasons = list(all_runs.reasons)
    for number in np.flatnonzero(further):
        row = rows[number]
        values[row], status[row], time[row] = again.values[number], again.status[number], again.failure_time[number]
        reasons[row] = again.reasons[number]
    return replace(all_runs, values=values, status=status, failure_time=time, reasons=tuple(reasons))


def name_failures(found: Histories, mesh: Mesh, shortest: float, channels: tuple[str, ...]) -> Histories:
    """Add the reason to every run that ended early, and remove channels recorded only for checks."""
    lost, weakest = found.channel("support_lost"), found.channel("weakest_joint")
    values = found.values[:, :, [found.channels.index(c) for c in channels]].copy()
    status, time, reasons = found.status.copy(), found.failure_time.copy(), list(found.reasons)
    for run in np.flatnonzero(~found.done | (np.nan_to_num(lost) >= 1.0).any(axis=1)):
        good = np.isfinite(lost[run])
        gone = good & (np.nan_to_num(lost[run]) >= 1.0)
        if gone.any():
            at = int(np.argmax(gone))
            status[run], time[run] = Status.STRUCTURE_FAILED, at * found.dt
            reasons[run] = f"the joint {_name(mesh, weakest[run, at])} lost its support at {time[run]:g} s"
            values[run, at:] = np.nan
        else:
            at = int(good.sum()) - 1
            reasons[run] = (
                "no equilibrium was found under the vertical load"
                if at < 0
                else (
                    f"no equilibrium was found from {time[run]:g} s on, in steps of {1e3 * shortest:.2g} ms; the joint "
                    f"{_name(mesh, weakest[run, at])} had lost most of its support ({lost[run, at]:.0%})"
                )
            )
    units = {c: u for c, u in found.units.items() if c in channels}
    return replace(
        found, values=values, channels=channels, status=status, failure_time=time, reasons=tuple(reasons), units=units
    )


def _name(mesh: Mesh, number: float) -> str:
    return mesh.joints[int(np.nan_to_num(number))].name
