"""structid run: a study from its file to its report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.screen import FAILED, errors, findings_on_screen, finish, screen, stage
from structid.core.errors import InputError

if TYPE_CHECKING:
    from structid.study.run import StudyOutcome
    from structid.study.timings import Stage


def run(
    study: Annotated[Path, typer.Argument(help="The study file (TOML).")],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for everything it makes; the file's name without ending where it is left out."),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue with what is in that folder.")] = False,
    executor: Annotated[
        str,
        typer.Option(
            help="Where an external solver's runs are done: serial, processes, processes:4, tcp://scheduler:8786."
        ),
    ] = "serial",
    retry: Annotated[
        bool, typer.Option("--retry", help="Repeat what failed, timed out or diverged; implies --resume.")
    ] = False,
    adopt: Annotated[
        bool,
        typer.Option("--adopt", help="Keep the model runs although the solver has changed; implies --resume."),
    ] = False,
) -> None:
    """Run a study: model runs, deterministic calibration, sampling, prediction, report."""
    folder = Path(study.stem) if out is None else out
    with findings_on_screen():
        outcome = worked_on_screen(study, folder, resume, executor, retry, adopt)
    finish(outcome)


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
        Folder for everything it makes.
    resume : bool
        Continue with what is in that folder.
    executor : str
        Where an external solver's runs are done.
    retry, adopt : bool
        See `run`.
    shown : callable
        Opens a progress bar.

    Returns
    -------
    StudyOutcome
        What came out.
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
    if built.model.batched and not resume:  # one run; a solver's is left to structid check
        for question in plausibility(built).questions:
            screen.print(f"? {question}", style="bold red", markup=False, soft_wrap=True)
    try:
        return run_study(study, out, resume, shown, executor, retry, adopt, built)
    except KeyboardInterrupt:
        errors.print("\nStopped. What is finished is on disk: run it again with --resume to go on.", style="yellow")
        raise typer.Exit(FAILED) from None
