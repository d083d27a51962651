"""structid runs: the state of a study's model runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.screen import print_plainly, screen
from structid.core.errors import Status
from structid.core.reasons import short_reason

if TYPE_CHECKING:
    from structid.campaign.runs import Runs


def runs(
    folder: Annotated[Path, typer.Argument(help="Output folder of structid run, or a file of runs.")],
    failed: Annotated[bool, typer.Option("--failed", help="Show every failed run with its parameters.")] = False,
    whole: Annotated[
        bool, typer.Option("--whole", help="Show the whole error message of the solver, not only its last line.")
    ] = False,
) -> None:
    """Show the state of a study's model runs: counts, reasons for failures, rates."""
    from structid.campaign.store import open_runs
    from structid.study.cost import duration

    stored = open_runs(folder)
    print_plainly(str(stored))
    seconds = stored.seconds[stored.seconds > 0]
    if seconds.size:
        median, longest = sorted(seconds)[len(seconds) // 2], seconds.max()
        total = duration(seconds.sum())
        screen.print(f"  {median:.3g} s per run (median), {longest:.3g} s at most, {total} of solver time in total")
    if stored.rate > 0:
        screen.print(f"  {stored.rate:.3g} runs/s over the last {min(100, len(stored))} runs")
    if failed:
        _list_failed(stored, whole)


def _list_failed(stored: Runs, whole: bool) -> None:
    factors, units = stored.design.space.factors, stored.design.space.units.values()
    for i in range(len(stored)):
        status = Status(stored.status[i])
        if status not in (Status.DONE, Status.PENDING):
            point = ", ".join(
                f"{n} {v:.6g}{' ' + u if u else ''}"
                for n, v, u in zip(stored.design.names, stored.design.values[i] / factors, units, strict=True)
            )
            times = f" (attempt {stored.attempts[i]})" if stored.attempts[i] > 1 else ""
            reason = stored.reasons[i] if whole else short_reason(stored.reasons[i])
            print_plainly(f"run {i}{times}: {status.words}: {reason}\n    {point}")
