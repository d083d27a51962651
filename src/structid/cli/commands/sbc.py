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
    whole: Annotated[
        bool, typer.Option("--whole", help="Make a whole calibration of each: error model, surrogate, certificate.")
    ] = False,
    noise: Annotated[
        float, typer.Option(help="With --whole: standard deviation of the noise, divided by the RMS of the response.")
    ] = 0.05,
) -> None:
    """Check by simulation whether the credible intervals of a study have their nominal coverage."""
    from structid.study.simulated_replicas import check_by_simulation, check_calibrations_by_simulation

    if whole:
        found, figure = check_calibrations_by_simulation(study, replicas, noise, out, seed, stage, executor)
        said, calibrated = str(found), found.calibrated
    else:
        ranks, figure = check_by_simulation(study, replicas, out, seed, stage, executor)
        said, calibrated = str(ranks), ranks.uniform
    screen.print()
    print_plainly(said, style="green" if calibrated else "bold red")
    if figure is not None:
        print_plainly(f"\nFigure: {figure.resolve()}")
    if not calibrated:
        raise typer.Exit(NOT_CONVERGED)
