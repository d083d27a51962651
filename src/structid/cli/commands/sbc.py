"""structid sbc: simulation-based calibration of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.screen import NOT_CONVERGED, print_plainly, screen, stage


def sbc(
    study: Annotated[Path, typer.Argument(help="The study file (TOML).")],
    replicas: Annotated[int, typer.Option(help="Number of simulated measurements.")] = 200,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the figure and the training runs of a surrogate.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed; default: the seed of the study.")] = None,
    executor: Annotated[str, typer.Option(help="Executor for the runs of an external solver.")] = "serial",
) -> None:
    """Check by simulation whether the credible intervals of a study have their nominal coverage."""
    from structid.study.simulated_replicas import check_by_simulation

    ranks, figure = check_by_simulation(study, replicas, out, seed, stage, executor)
    screen.print()
    print_plainly(str(ranks), style="green" if ranks.uniform else "bold red")
    if figure is not None:
        print_plainly(f"\nFigure: {figure.resolve()}")
    if not ranks.uniform:
        raise typer.Exit(NOT_CONVERGED)
