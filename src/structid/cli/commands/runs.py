"""structid runs: how the true runs of a study stand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.screen import screen
from structid.core.errors import Status
from structid.core.reasons import short_reason

if TYPE_CHECKING:
    from structid.campaign.runs import Runs


def runs(
    folder: Annotated[Path, typer.Argument(help="A folder that structid run has filled, or a file of runs.")],
    failed: Annotated[bool, typer.Option("--failed", help="Show every run that failed, with its parameters.")] = False,
    whole: Annotated[
        bool, typer.Option("--whole", help="Show all that the solver last said, not only its last line.")
    ] = False,
) -> None:
    """Say how the true runs of a study stand: counts, failures by reason, rates."""
    from structid.campaign.store import open_runs
    from structid.study.cost import duration

    found = open_runs(folder)
    screen.print(str(found), markup=False, soft_wrap=True)
    seconds = found.seconds[found.seconds > 0]
    if seconds.size:
        median, longest = sorted(seconds)[len(seconds) // 2], seconds.max()
        total = duration(seconds.sum())
        screen.print(f"  {median:.3g} s a run (median), {longest:.3g} s at most, {total} of solver time in all")
    if found.rate > 0:
        screen.print(f"  {found.rate:.3g} runs/s over the last {min(100, len(found))}")
    if failed:
        _list_failed(found, whole)


def _list_failed(found: Runs, whole: bool) -> None:
    factors, units = found.design.space.factors, found.design.space.units.values()
    for i in range(len(found)):
        status = Status(found.status[i])
        if status not in (Status.DONE, Status.PENDING):
            point = ", ".join(
                f"{n} {v:.6g}{' ' + u if u else ''}"
                for n, v, u in zip(found.design.names, found.design.values[i] / factors, units, strict=True)
            )
            times = f" (attempt {found.attempts[i]})" if found.attempts[i] > 1 else ""
            reason = found.reasons[i] if whole else short_reason(found.reasons[i])
            screen.print(f"run {i}{times}: {status.words}: {reason}\n    {point}", markup=False, soft_wrap=True)
