"""structid report: rewrite the report from stored results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.commands.hybrid import finish_programme
from structid.cli.screen import finish, stage


def report(
    folder: Annotated[Path, typer.Argument(help="Output folder of structid run or structid hybrid.")],
) -> None:
    """Rewrite the report from stored results."""
    from structid.study.folder_layout import STUDY
    from structid.study.programmes.programme_file import is_programme
    from structid.study.programmes.run_programme import programme_report_again
    from structid.study.run import report_again
    from structid.study.schema.study_file import study_content

    if (folder / STUDY).is_file() and is_programme(study_content(folder / STUDY)):
        finish_programme(programme_report_again(folder, stage))
    else:
        finish(report_again(folder, stage))
