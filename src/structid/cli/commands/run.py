"""structid run: a study, from the study file to the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.screen import (
    FAILED,
    errors,
    findings_on_screen,
    finish,
    finish_cyclic_test,
    print_plainly,
    screen,
    stage,
)
from structid.core.errors import InputError

if TYPE_CHECKING:
    from structid.study.cyclic_tests.run_cyclic_test import CyclicOutcome
    from structid.study.run import StudyOutcome
    from structid.study.timings import Stage

STOPPED = "\nStopped. Finished results are on disk; rerun with --resume to continue."


def run(
    study: Annotated[Path, typer.Argument(help="The study file (TOML).")],
    out: Annotated[
        Path | None,
        typer.Option(help="Output folder; default: the name of the study file without its extension."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the results in the output folder.")] = False,
    executor: Annotated[
        str,
        typer.Option(
            help="Executor for the runs of an external solver: serial, processes, processes:4, tcp://scheduler:8786."
        ),
    ] = "serial",
    retry: Annotated[
        bool, typer.Option("--retry", help="Repeat runs that failed, timed out or diverged; implies --resume.")
    ] = False,
    adopt: Annotated[
        bool,
        typer.Option("--adopt", help="Keep the stored model runs even if the solver has changed; implies --resume."),
    ] = False,
) -> None:
    """Run a study: model runs, deterministic calibration, sampling, prediction, report."""
    from structid.study.cyclic_tests.cyclic_test_file import is_cyclic_test
    from structid.study.schema.study_file import study_content

    folder = Path(study.stem) if out is None else out
    if is_cyclic_test(study_content(study)):
        with findings_on_screen():
            cyclic = _cyclic_test_on_screen(study, folder, resume)
        finish_cyclic_test(cyclic)
        return
    with findings_on_screen():
        outcome = worked_on_screen(study, folder, resume, executor, retry, adopt)
    finish(outcome)


def _cyclic_test_on_screen(study: Path, out: Path, resume: bool) -> CyclicOutcome:
    """Choose the law of a cyclic test with progress bars."""
    from structid.study.cyclic_tests.run_cyclic_test import run_cyclic_test

    screen.print(f"[bold]structid[/] {study.name} → {out}")
    try:
        return run_cyclic_test(study, out, resume, stage)
    except KeyboardInterrupt:
        errors.print(STOPPED, style="yellow")
        raise typer.Exit(FAILED) from None


def worked_on_screen(
    study: Path,
    out: Path,
    resume: bool,
    executor: str = "serial",
    retry: bool = False,
    adopt: bool = False,
    shown: Stage = stage,
) -> StudyOutcome:
    """Run a study with progress bars.

    Parameters
    ----------
    study : Path
        The study file.
    out : Path
        Output folder.
    resume : bool
        Continue from the results in the output folder.
    executor : str
        Executor for the runs of an external solver.
    retry, adopt : bool
        See `run`.
    shown : callable
        Context manager that opens a progress bar.

    Returns
    -------
    StudyOutcome
        Outcome of the study.
    """
    from structid.study.plausibility import plausibility
    from structid.study.programmes.programme_file import is_programme
    from structid.study.run import load, run_study
    from structid.study.schema.study_file import study_content

    if is_programme(study_content(study)):
        raise InputError(
            f"{study}", "a programme of hybrid tests", "a study", f"Run it with: structid hybrid {study} --out {out}"
        )
    screen.print(f"[bold]structid[/] {study.name} → {out}")
    built = load(study)
    if built.model.batched and not resume:  # one cheap run; an external solver is run by structid check only
        for question in plausibility(built).questions:
            print_plainly(f"? {question}", style="bold red")
    try:
        return run_study(study, out, resume, shown, executor, retry, adopt, built)
    except KeyboardInterrupt:
        errors.print(STOPPED, style="yellow")
        raise typer.Exit(FAILED) from None
