"""structid hybrid: a programme of hybrid tests, from the study file to the report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.screen import FAILED, NOT_CONVERGED, WRONG_INPUT, errors, print_plainly, screen, stage
from structid.cli.specimen_secret import SecretFile, secret_of

if TYPE_CHECKING:
    from structid.hybrid.feasibility import Feasibility
    from structid.study.programmes.run_programme import ProgrammeOutcome


def hybrid(
    study: Annotated[Path, typer.Argument(help="The programme file (TOML).")],
    out: Annotated[Path | None, typer.Option(help="Output folder.")] = None,
    specimen: Annotated[
        str,
        typer.Option(
            help="HOST:PORT of the specimen server, or openfresco://HOST:PORT; default: the simulated specimen."
        ),
    ] = "",
    secret_file: SecretFile = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue from the results in the output folder; simulated specimens only.")
    ] = False,
    show: Annotated[bool, typer.Option("--live", help="Serve a local web page that shows the running tests.")] = False,
    live_port: Annotated[int, typer.Option(help="Port of the live page.", min=1, max=65535)] = 8765,
    only_check: Annotated[
        bool, typer.Option("--check", help="Report which tests are feasible; no specimen moves.")
    ] = False,
) -> None:
    """Run a programme of hybrid tests: checks, tests on one specimen, parameter learning, report."""
    from structid.study.echo import quantities_in_si
    from structid.study.programmes.run_programme import check_programme, run_programme

    secret = partial(secret_of, secret_file)
    if only_check:
        print_checks(check_programme(study, specimen, secret), quantities_in_si(study))
        return
    if out is None:
        raise typer.BadParameter("the output folder is missing", param_hint="--out")
    screen.print(f"[bold]structid[/] {study.name} → {out}")
    try:
        with _live(out, live_port) if show else nullcontext():
            outcome = run_programme(
                study,
                out,
                address=specimen,
                secret=secret,
                resume=resume,
                stage=stage,
                watching=lambda name, test: screen.print(
                    f"test {name}: {test.record.name}, λ {test.time_scale:g}", markup=False
                ),
            )
    except KeyboardInterrupt:
        errors.print("\nStopped. Every finished step is on disk.", style="yellow")
        raise typer.Exit(FAILED) from None
    finish_programme(outcome)


@contextmanager
def _live(out: Path, port: int) -> Iterator[None]:
    """Serve the live view, and print its address."""
    from structid.report.live import live

    with live(out, port) as address:
        screen.print(f"Live view: {address}")
        yield


def print_checks(checks: dict[str, Feasibility], quantities: Sequence[str]) -> None:
    """Print the feasibility of every test before anything moves; exit with an error code if a test is infeasible.

    Parameters
    ----------
    checks : dict of str to Feasibility
        Feasibility by name of the test.
    quantities : sequence of str
        Quantities of the file in SI units, one line per quantity.
    """
    for line in quantities:
        print_plainly(line)
    for name, feasibility in checks.items():
        screen.print(f"\n[bold]test {name}[/]")
        print_plainly(str(feasibility))
    if not all(feasibility.can_work for feasibility in checks.values()):
        raise typer.Exit(WRONG_INPUT)


def finish_programme(outcome: ProgrammeOutcome) -> None:
    """Print the results of a programme; the exit code shows whether it finished and whether its result can be trusted.

    Parameters
    ----------
    outcome : ProgrammeOutcome
        Outcome of the programme.
    """
    screen.print()
    print_plainly(str(outcome.programme))
    learnt, trusted = outcome.learnt, True
    if learnt is not None:
        verdict = learnt.result.verdict()
        trusted = learnt.trusted
        screen.print()
        print_plainly(str((learnt.calibration or learnt.result).summary()))
        if learnt.calibration is not None:
            certificate = str(learnt.calibration.certificate)
            print_plainly(certificate, style="green" if trusted else "bold red")
        print_plainly(str(verdict), style="green" if trusted and not verdict.doubt else "bold red")
        for sentence in learnt.prediction.sentences if learnt.prediction is not None else ():
            print_plainly(sentence)
    print_plainly(f"\nReport: {outcome.report.resolve()}")
    if not outcome.programme.finished:
        raise typer.Exit(FAILED)
    if not trusted:
        raise typer.Exit(NOT_CONVERGED)
