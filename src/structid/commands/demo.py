"""structid demo: the packaged study, on a record made on the spot."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from structid.commands.run import run_on_screen


def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything the demo makes.")] = Path("demo"),
) -> None:
    """Run the packaged study on a record made on the spot: data, calibration, report."""
    packaged = resources.files("structid") / "study" / "templates" / "bouc_wen.toml"
    with resources.as_file(packaged) as study:
        run_on_screen(study, out, resume=(out / "identity.json").is_file())
