"""A command of somebody else's."""

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.screen import screen


def parameters(study: Annotated[Path, typer.Argument(help="The study file (TOML).")]) -> None:
    """Say which parameters a study leaves open."""
    from structid.study.run import load

    screen.print(", ".join(load(study).space.names))
