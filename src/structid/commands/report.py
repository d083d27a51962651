"""structid report: the page again, from what is stored."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.commands.screen import finish, stage


def report(folder: Annotated[Path, typer.Argument(help="A folder that structid run has filled.")]) -> None:
    """Write the report again from what is stored."""
    from structid.study.run import report_again

    finish(report_again(folder, stage))
