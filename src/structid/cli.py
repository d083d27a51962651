"""The command line: demo, run, check, report, compare, sbc, runs, serve, new. It owns the screen; nothing below it prints."""

from __future__ import annotations

import importlib.metadata
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from structid.errors import CampaignStoppedError, InputError, StructidError

if TYPE_CHECKING:
    from structid.runs import Runs
    from structid.study.building.built_study import BuiltStudy
    from structid.study.run import Outcome

DONE, FAILED, WRONG_INPUT, NOT_CONVERGED = 0, 1, 2, 3
"""Exit codes."""

TEMPLATES = ("bouc_wen", "shear_frame", "external")
"""Studies that ship with the package."""

SOLVERS = {"external": "external_solver.py"}
"""Files a packaged study needs beside it."""

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Bayesian structural identification: from a measured response history to a posterior one can trust.",
)
screen = Console(highlight=False)
errors = Console(stderr=True, highlight=False)


def template(name: str) -> str:
    """Text of a packaged study, or of the solver beside it.

    Parameters
    ----------
    name : str
        One of `TEMPLATES`, or of the files in `SOLVERS`.

    Returns
    -------
    str
        TOML, or Python.
    """
    file = f"{name}.toml" if name in TEMPLATES else name
    return (resources.files("structid") / "study" / "templates" / file).read_text(encoding="utf-8")


@app.callback(invoke_without_command=True)
def about(
    version: Annotated[bool, typer.Option("--version", help="Say the version.", is_eager=True)] = False,
) -> None:
    """Bayesian structural identification: from a measured response history to a posterior one can trust."""
    if version:
        screen.print(importlib.metadata.version("structid"))
        raise typer.Exit(DONE)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything the demo makes.")] = Path("demo"),
) -> None:
    """Run the packaged study on a record made on the spot: data, calibration, report."""
    packaged = resources.files("structid") / "study" / "templates" / "bouc_wen.toml"
    with resources.as_file(packaged) as study:
        _run(study, out, resume=(out / "identity.json").is_file())


@app.command()
def run(
    study: Annotated[Path, typer.Argument(help="The study file (TOML).")],
    out: Annotated[Path, typer.Option(help="Folder for everything it makes.")],
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what is in that folder.")] = False,
    executor: Annotated[
        str,
        typer.Option(
            help="Where an external solver's runs are done: serial, processes, processes:4, tcp://scheduler:8786."
        ),
    ] = "serial",
    retry: Annotated[
        bool, typer.Option("--retry", help="Do again what failed, timed out or diverged; implies --resume.")
    ] = False,
    adopt: Annotated[
        bool,
        typer.Option("--adopt", help="Keep the true runs although the solver has changed since; implies --resume."),
    ] = False,
) -> None:
    """Run a study: true runs, deterministic calibration, sampling, prediction, report."""
    _run(study, out, resume, executor, retry, adopt)


@app.command()
def check(study: Annotated[Path, typer.Argument(help="The study file (TOML).")]) -> None:
    """Say everything that is wrong with a study and what it will cost, without running it."""
    from structid.study.cost import estimate
    from structid.study.plausibility import plausibility
    from structid.study.run import load

    built = load(study)
    _describe(built)
    with screen.status("running the model a few times"):
        sizes, cost = plausibility(built), estimate(built)
    screen.print("\n".join([*sizes, str(cost)]), markup=False, soft_wrap=True)
    screen.print(f"[bold green]{study} is in order.[/]")


@app.command()
def report(folder: Annotated[Path, typer.Argument(help="A folder that structid run has filled.")]) -> None:
    """Write the report again from what is stored."""
    from structid.study.run import report_again

    _finish(report_again(folder, stage))


@app.command()
def compare(
    folders: Annotated[list[Path], typer.Argument(help="Folders of finished studies of one measurement.")],
    out: Annotated[Path | None, typer.Option(help="Folder for a page with their predictions side by side.")] = None,
) -> None:
    """Say which model class the data favour: evidence, Bayes factors, what is predicted of stretches left out."""
    from structid.study.compare import compare_studies

    comparison, page = compare_studies(folders, out, stage)
    trusted = all(c.trusted for c in comparison.classes)
    screen.print()
    screen.print(comparison.verdict, style="green" if trusted else "bold red", markup=False, soft_wrap=True)
    heads, rows = comparison.rows()
    _print_table(heads, rows)
    if page is not None:
        screen.print(f"\nPage: {page.resolve()}", markup=False, soft_wrap=True)
    if not trusted:
        raise typer.Exit(NOT_CONVERGED)


@app.command()
def sbc(
    study: Annotated[Path, typer.Argument(help="The study file (TOML).")],
    replicas: Annotated[int, typer.Option(help="Measurements to simulate and calibrate to.")] = 200,
    out: Annotated[Path | None, typer.Option(help="Folder for the figure, and for the runs of a surrogate.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed; the study's when left out.")] = None,
    executor: Annotated[str, typer.Option(help="Where an external solver's runs are done.")] = "serial",
) -> None:
    """Check a study by simulation: whether its intervals hold the truth as often as they say."""
    from structid.study.replicas import check_by_simulation

    ranks, figure = check_by_simulation(study, replicas, out, seed, stage, executor)
    screen.print()
    screen.print(str(ranks), style="green" if ranks.uniform else "bold red", markup=False, soft_wrap=True)
    if figure is not None:
        screen.print(f"\nFigure: {figure.resolve()}", markup=False, soft_wrap=True)
    if not ranks.uniform:
        raise typer.Exit(NOT_CONVERGED)


@app.command()
def runs(
    folder: Annotated[Path, typer.Argument(help="A folder that structid run has filled, or a file of runs.")],
    failed: Annotated[bool, typer.Option("--failed", help="Show every run that failed, with its parameters.")] = False,
    whole: Annotated[
        bool, typer.Option("--whole", help="With all the solver last said, not its last line alone.")
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


@app.command()
def serve(
    study: Annotated[Path, typer.Argument(help="The study file (TOML).")],
    port: Annotated[int, typer.Option(help="Where to listen.")] = 4242,
) -> None:
    """Serve a study's model, and its posterior, over UM-Bridge (HTTP)."""
    from structid.solvers.um_bridge import serve as serve_models
    from structid.study.run import load
    from structid.study.serve import offered

    models = offered(load(study))
    screen.print(f"Serving {', '.join(m.name for m in models)} at http://localhost:{port} (Ctrl-C stops)")
    serve_models(models, port)


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the study; NAME.toml is written here.")],
    like: Annotated[
        str, typer.Option(help=f"Which packaged study to start from: {', '.join(TEMPLATES)}.")
    ] = "bouc_wen",
) -> None:
    """Write a study file to start from."""
    from structid.errors import check_choice

    check_choice("--like", like, TEMPLATES)
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    if path.exists():
        raise InputError(f"{path}", "it exists already", "a new name", "Choose another name, or remove the file.")
    if not path.parent.is_dir():
        raise InputError(
            f"{path}", f"there is no folder '{path.parent}'", "a name in a folder that exists", "Make the folder first."
        )
    solver = SOLVERS.get(like)
    if solver is not None and (path.parent / solver).exists():
        raise InputError(
            f"{path.parent / solver}", "it exists already", "a folder without it", "Choose another folder."
        )
    text = template(like).replace(f'name = "{like}"', f'name = "{path.stem}"', 1)
    path.write_text(text, encoding="utf-8")
    if solver is not None:
        (path.parent / solver).write_text(template(solver), encoding="utf-8")
        screen.print(f"Wrote {path.parent / solver}, a solver to put yours in place of.")
    screen.print(f"Wrote {path}. Edit it, then: structid check {path}")


@contextmanager
def stage(name: str) -> Iterator[Any]:
    """Open a progress bar with rate and time left.

    Parameters
    ----------
    name : str
        What is going on.

    Yields
    ------
    callable
        To be told how much is done, of how much.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description:<24}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TextColumn("{task.fields[failed]}", style="red"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=screen) as bar:
        task = bar.add_task(name, total=None, rate="", failed="")

        def told(done: int, total: int, failed: int = 0) -> None:
            speed = bar.tasks[0].speed
            rate, lost = f"{speed:.1f}/s" if speed else "", f"{failed} failed" if failed else ""
            bar.update(task, completed=done, total=total, rate=rate, failed=lost)

        yield told
        total = bar.tasks[0].total or 1
        bar.update(task, completed=total, total=total)


def _run(
    study: Path, out: Path, resume: bool, executor: str = "serial", retry: bool = False, adopt: bool = False
) -> None:
    from structid.study.run import run_study

    screen.print(f"[bold]structid[/] {study.name} → {out}")
    try:
        outcome = run_study(study, out, resume, stage, executor, retry, adopt)
    except KeyboardInterrupt:
        errors.print("\nStopped. What is finished is on disk: run it again with --resume to go on.", style="yellow")
        raise typer.Exit(FAILED) from None
    _finish(outcome)


def _print_table(heads: list[str], rows: list[list[str]]) -> None:
    """A row a thing where the screen is wide enough, else a block a thing."""
    from structid.inference.assessment.comparison import aligned

    lines = aligned(heads, rows)
    if max(map(len, lines)) <= screen.width:
        screen.print("\n".join(lines), markup=False, soft_wrap=True)
        return
    for row in rows:
        screen.print(f"\n{row[0]}", style="bold", markup=False)
        for head, cell in zip(heads[1:], row[1:], strict=True):
            screen.print(f"  {head.ljust(max(map(len, heads)))}  {cell}", markup=False, soft_wrap=True)


def _describe(built: BuiltStudy) -> None:
    screen.print(str(built.record), markup=False)
    screen.print(str(built.model), markup=False)
    screen.print(repr(built.space), markup=False)


def _list_failed(found: Runs, whole: bool) -> None:
    from structid.errors import Status
    from structid.reasons import short_reason

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


def _finish(outcome: Outcome) -> None:
    """Say what came out; the exit code says whether to believe it."""
    screen.print()
    if outcome.runs is not None:
        screen.print(str(outcome.runs), markup=False, soft_wrap=True)
        screen.print()
    if outcome.result is None:
        screen.print(f"Report: {outcome.report.resolve()}", markup=False, soft_wrap=True)
        if outcome.runs is not None and not outcome.runs.done.any():
            raise CampaignStoppedError("No run is done: see structid runs DIR --failed.")
        return
    summary = (outcome.calibration or outcome.result).summary()
    screen.print(str(summary), markup=False, soft_wrap=True)
    screen.print()
    if outcome.result.cost is not None:
        screen.print(f"Exact: {outcome.result.cost}", style="green", soft_wrap=True)
        screen.print()
    if outcome.calibration is not None:
        certificate = outcome.calibration.certificate
        screen.print(
            str(certificate), style="green" if certificate.certified else "bold red", markup=False, soft_wrap=True
        )
        screen.print()
    verdict = outcome.result.verdict()
    screen.print(str(verdict), style="green" if verdict.converged else "bold red", markup=False, soft_wrap=True)
    screen.print(f"\nReport: {outcome.report.resolve()}", markup=False, soft_wrap=True)
    if not outcome.trusted:
        raise typer.Exit(NOT_CONVERGED)


def _stopped_by_the_system(number: int, frame: Any) -> None:
    """Treat a polite kill, as batch systems send it, like Ctrl-C."""
    raise KeyboardInterrupt


def main() -> None:
    """Run the command line; a user's mistake is one paragraph and exit code 2."""
    signal.signal(signal.SIGTERM, _stopped_by_the_system)
    try:
        # Without its standalone mode typer returns the exit code and lets errors through.
        sys.exit(app(standalone_mode=False) or DONE)
    except InputError as mistake:
        errors.print(str(mistake), style="red", markup=False, soft_wrap=True)
        sys.exit(WRONG_INPUT)
    except StructidError as failure:
        errors.print(str(failure), style="red", markup=False, soft_wrap=True)
        sys.exit(FAILED)
    except OSError as failure:
        errors.print(f"{failure.filename or 'a file'}: {failure.strerror or failure}.", style="red", markup=False)
        sys.exit(FAILED)
    except Exception as problem:
        if hasattr(problem, "show") and hasattr(problem, "exit_code"):  # a mistake on the command line itself
            problem.show()
            sys.exit(WRONG_INPUT)
        raise
