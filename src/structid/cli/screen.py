"""Screen output of commands, progress bars, and exit codes."""

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
    from structid.inference.sampling_result import SamplingResult
    from structid.study.cyclic_tests.run_cyclic_test import CyclicOutcome
    from structid.study.run import StudyOutcome

DONE = 0
"""Exit code: done."""
FAILED = 1
"""Exit code: the command could not be completed."""
WRONG_INPUT = 2
"""Exit code: the input is wrong."""
NOT_CONVERGED = 3
"""Exit code: done, but the result is not converged or not certified."""

SILENCE = 30.0
"""Interval [s] between the status lines of a long stage if the output is not a terminal."""

LOGGED = ("calibration", "inference", "law_choice")
"""Loggers whose messages are shown during a run."""

screen = Console(highlight=False)
errors = Console(stderr=True, highlight=False)


@contextmanager
def stage(name: str, passing: bool = False) -> Iterator[Any]:
    """Show the progress of a stage by a bar, or by lines if the output is not a terminal."""
    with _bar(name, passing) if screen.is_terminal else _lines(name, passing) as report:
        yield report


@contextmanager
def _bar(name: str, passing: bool) -> Iterator[Callable[..., None]]:
    """Show a bar with the rate and the remaining time."""
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

        def report(done: int, total: int, failed: int = 0) -> None:
            speed = bar.tasks[0].speed
            rate, lost = f"{speed:.1f}/s" if speed else "", f"{failed} failed" if failed else ""
            bar.update(task, completed=done, total=total, rate=rate, failed=lost)

        yield report
        total = bar.tasks[0].total or 1
        bar.update(task, completed=total, total=total)


@contextmanager
def _lines(name: str, silent: bool) -> Iterator[Callable[..., None]]:
    """Print a line every half minute and a line at the end, for a file or a batch queue."""
    began = reported = time.monotonic()
    of, lost = "", ""

    def print_line(done: str, end: str = "") -> None:
        if not silent:
            after = f"{time.monotonic() - began:.0f} s{end}"
            print_plainly(f"{name:<30} {done + of + lost:>13}  {after}")

    def report(done: int, total: int, failed: int = 0) -> None:
        nonlocal reported, of, lost
        of, lost = f"/{total:,}", f", {failed} failed" if failed else ""
        if time.monotonic() > reported + SILENCE:
            reported = time.monotonic()
            print_line(f"{done:,}", ", continuing")

    yield report
    print_line(of[1:])  # a stage that ends before its last step has reached its goal


@contextmanager
def findings_on_screen() -> Iterator[None]:
    """Print findings as soon as they are logged: every round of a calibration, the chosen error model."""
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
    """Handler that prints log messages above the progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        print_plainly(record.getMessage(), style="bold")


def print_table(heads: list[str], rows: list[list[str]]) -> None:
    """Print a table: one row per item if the screen is wide enough, otherwise one block per item."""
    from structid.inference.model_comparison.comparison import aligned

    lines = aligned(heads, rows)
    if max(map(len, lines)) <= screen.width:
        print_plainly("\n".join(lines))
        return
    for row in rows:
        screen.print(f"\n{row[0]}", style="bold", markup=False)
        for head, cell in zip(heads[1:], row[1:], strict=True):
            print_plainly(f"  {head.ljust(max(map(len, heads)))}  {cell}")


def finish(outcome: StudyOutcome) -> None:
    """Print the result of a study; exit with `NOT_CONVERGED` if the result cannot be trusted."""
    from structid.campaign.runs import Runs

    screen.print()
    _print_results_of_tables(outcome, needs_draws=False)
    runs = outcome.results.get(Runs)
    if runs is not None:
        print_plainly(str(runs))
        screen.print()
    if outcome.result is None:
        print_plainly(f"Report: {outcome.report.resolve()}")
        if runs is not None and not runs.done.any():
            raise CampaignStoppedError("No run has finished. See the reasons with: structid runs DIR --failed")
        return
    _print_posterior(outcome, outcome.result)
    print_plainly(f"\nReport: {outcome.report.resolve()}")
    if not outcome.trusted:
        raise typer.Exit(NOT_CONVERGED)


def finish_cyclic_test(outcome: CyclicOutcome) -> None:
    """Print the choice of the law of a cyclic test; exit with `NOT_CONVERGED` if the draws have not converged."""
    screen.print()
    for question in outcome.choice.cyclic_test.questions:
        print_plainly(f"? {question}", style="bold red")
    print_plainly(f"{outcome.choice}\n")
    print_plainly(str(outcome.choice.result.summary()))
    verdict = outcome.choice.result.verdict()
    print_plainly(str(verdict), "green" if outcome.trusted and not verdict.doubt else "bold red")
    print_plainly(f"\nReport: {outcome.report.resolve()}")
    if not outcome.trusted:
        raise typer.Exit(NOT_CONVERGED)


def _print_posterior(outcome: StudyOutcome, result: SamplingResult) -> None:
    """Print the summary, the error model, the certificate and the verdict."""
    from structid.calibration.calibration_result import CalibrationResult
    from structid.inference.error_model_choice import ErrorModelChoice
    from structid.law_choice.law_comparison import LawComparison
    from structid.report.page_summary import page_summary

    assert outcome.material is not None
    print_plainly(f"{page_summary(outcome.material)}\n")
    choice, calibration = outcome.results.get(ErrorModelChoice), outcome.results.get(CalibrationResult)
    verdict = result.verdict()
    if (laws := outcome.results.get(LawComparison)) is not None:
        print_plainly(f"{laws}\n")
    if choice is not None:
        print_plainly(f"{choice.sentence}\n")
    trusted = "green" if outcome.trusted else "bold red"
    if result.cost is not None:
        exact = "Exact" if verdict.converged else "Asymptotically exact, but not converged"
        print_plainly(f"{exact}: {result.cost}\n", trusted)
    if calibration is not None:
        print_plainly(f"{calibration.certificate}\n", trusted)
    print_plainly(str(verdict), "green" if verdict.converged and not verdict.doubt else "bold red")
    _print_results_of_tables(outcome, needs_draws=True)


def _print_results_of_tables(outcome: StudyOutcome, needs_draws: bool) -> None:
    """Print the results of the stages that have their own table in the study file."""
    from structid.study.stages import stage_list

    for stage in stage_list.STAGES:
        if stage.table is not None and stage.table.needs_draws == needs_draws and stage.result in outcome.results:
            print_plainly(f"{outcome.results[stage.result]}\n")


def print_plainly(text: str, style: str = "") -> None:
    """Print text unchanged: brackets are not markup, and lines are not broken."""
    screen.print(text, style=style, markup=False, soft_wrap=True)
