"""The screen: output of commands, progress bars, exit codes."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console

from structid.core.errors import CampaignStoppedError

if TYPE_CHECKING:
    from structid.study.run import StudyOutcome

DONE = 0
"""Exit code: done."""
FAILED = 1
"""Exit code: it could not be done."""
WRONG_INPUT = 2
"""Exit code: the input is wrong."""
NOT_CONVERGED = 3
"""Exit code: done, but not converged or not certified."""

SILENCE = 30.0
"""Interval [s] of status lines of a long stage without a terminal."""

LOGGED = ("calibration", "inference")
"""Loggers whose messages are shown during a run."""

screen = Console(highlight=False)
errors = Console(stderr=True, highlight=False)


@contextmanager
def stage(name: str, passing: bool = False) -> Iterator[Any]:
    """Show the progress of a stage: a bar, or lines without a terminal."""
    with _bar(name, passing) if screen.is_terminal else _lines(name, passing) as report:
        yield report


@contextmanager
def _bar(name: str, passing: bool) -> Iterator[Callable[..., None]]:
    """A bar with rate and remaining time."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description:<30}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TextColumn("{task.fields[failed]}", style="red"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=screen, transient=passing) as bar:
        task = bar.add_task(name, total=None, rate="", failed="")

        def told(done: int, total: int, failed: int = 0) -> None:
            speed = bar.tasks[0].speed
            rate, lost = f"{speed:.1f}/s" if speed else "", f"{failed} failed" if failed else ""
            bar.update(task, completed=done, total=total, rate=rate, failed=lost)

        yield told
        total = bar.tasks[0].total or 1
        bar.update(task, completed=total, total=total)


@contextmanager
def _lines(name: str, silent: bool) -> Iterator[Callable[..., None]]:
    """A line at the end, and one every half minute, for a file or a batch queue."""
    began = reported = time.monotonic()
    of, lost = "", ""

    def say(done: str, end: str = "") -> None:
        if not silent:
            after = f"{time.monotonic() - began:.0f} s{end}"
            screen.print(f"{name:<30} {done + of + lost:>13}  {after}", markup=False, soft_wrap=True)

    def told(done: int, total: int, failed: int = 0) -> None:
        nonlocal reported, of, lost
        of, lost = f"/{total:,}", f", {failed} failed" if failed else ""
        if time.monotonic() > reported + SILENCE:
            reported = time.monotonic()
            say(f"{done:,}", ", going on")

    yield told
    say(of[1:])  # what ends before its last step has found what it was after


@contextmanager
def findings_on_screen() -> Iterator[None]:
    """Print findings as they are logged: every round of a calibration, the error model."""
    logs, handler = [logging.getLogger(f"structid.{room}") for room in LOGGED], _OnScreen(logging.INFO)
    levels = [log.level for log in logs]
    for log in logs:
        log.addHandler(handler)
        log.setLevel(logging.INFO)
    try:
        yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.removeHandler(handler)
            log.setLevel(level)


class _OnScreen(logging.Handler):
    """Log messages on the screen, above a progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        screen.print(record.getMessage(), style="bold", markup=False, soft_wrap=True)


def print_table(heads: list[str], rows: list[list[str]]) -> None:
    """Print a table: one row per item where the screen is wide enough, else a block."""
    from structid.inference.model_comparison.comparison import aligned

    lines = aligned(heads, rows)
    if max(map(len, lines)) <= screen.width:
        screen.print("\n".join(lines), markup=False, soft_wrap=True)
        return
    for row in rows:
        screen.print(f"\n{row[0]}", style="bold", markup=False)
        for head, cell in zip(heads[1:], row[1:], strict=True):
            screen.print(f"  {head.ljust(max(map(len, heads)))}  {cell}", markup=False, soft_wrap=True)


def finish(outcome: StudyOutcome) -> None:
    """Print the result of a study. The exit code shows whether to believe it."""
    screen.print()
    if outcome.parameter_study is not None:
        screen.print(str(outcome.parameter_study), markup=False, soft_wrap=True)
    if outcome.runs is not None:
        screen.print(str(outcome.runs), markup=False, soft_wrap=True)
        screen.print()
    if outcome.result is None:
        screen.print(f"Report: {outcome.report.resolve()}", markup=False, soft_wrap=True)
        if outcome.runs is not None and not outcome.runs.done.any():
            raise CampaignStoppedError("No run is done: see structid runs DIR --failed.")
        return
    from structid.report.page_summary import page_summary

    assert outcome.material is not None
    screen.print(str(page_summary(outcome.material)), markup=False, soft_wrap=True)
    screen.print()
    if outcome.law_choice is not None:
        screen.print(outcome.law_choice.sentence, markup=False, soft_wrap=True)
        screen.print()
    if outcome.result.cost is not None:
        exact = "Exact" if outcome.result.verdict().converged else "Exact in the long run, but not converged"
        screen.print(
            f"{exact}: {outcome.result.cost}", style="green" if outcome.trusted else "bold red", soft_wrap=True
        )
        screen.print()
    if outcome.calibration is not None:
        certificate = str(outcome.calibration.certificate)
        screen.print(certificate, style="green" if outcome.trusted else "bold red", markup=False, soft_wrap=True)
        screen.print()
    verdict = outcome.result.verdict()
    good = verdict.converged and not verdict.doubt
    screen.print(str(verdict), style="green" if good else "bold red", markup=False, soft_wrap=True)
    screen.print(f"\nReport: {outcome.report.resolve()}", markup=False, soft_wrap=True)
    if not outcome.trusted:
        raise typer.Exit(NOT_CONVERGED)
