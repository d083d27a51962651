"""structid certify: certify external draws from a study's posterior with runs of the study's model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.screen import NOT_CONVERGED, print_plainly, screen, stage


def certify(
    study: Annotated[Path, typer.Argument(help="The study file (TOML): model, measurements, priors.")],
    draws: Annotated[
        Path, typer.Argument(help="Draws in SI units: a netCDF file (ArviZ schema) or a CSV file with a header.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the model runs, the certificate and its report.")] = Path(
        "certificate"
    ),
    runs: Annotated[int | None, typer.Option(help="Model runs; default 30, or 60 for draws without densities.")] = None,
    look: Annotated[int, typer.Option(help="Attempt number: 2 for a second certificate of the same draws.")] = 1,
    executor: Annotated[str, typer.Option(help="Executor for the runs of an external solver.")] = "serial",
) -> None:
    """Certify posterior draws from another program with a few runs of the study's model."""
    from structid.study.certified_draws import certify_draws

    certificate, page = certify_draws(study, draws, out, runs, look, stage, executor)
    screen.print()
    print_plainly(str(certificate), style="green" if certificate.certified else "bold red")
    print_plainly(f"\nReport: {page.resolve()}")
    if not certificate.certified:
        raise typer.Exit(NOT_CONVERGED)
