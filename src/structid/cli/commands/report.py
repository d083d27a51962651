"""structid report: rewrite the report from stored results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.commands.hybrid import finish_programme
from structid.cli.screen import finish, finish_cyclic_test, stage


def report(
    folder: Annotated[Path, typer.Argument(help="Output folder of structid run or structid hybrid.")],
) -> None:
    """Rewrite the report from stored results."""
    from structid.study.cyclic_tests.cyclic_test_file import is_cyclic_test
    from structid.study.cyclic_tests.run_cyclic_test import cyclic_report_again
    from structid.study.folder_layout import STUDY
    from structid.study.programmes.programme_file import is_programme
    from structid.study.programmes.run_programme import programme_report_again
    from structid.study.run import report_again
    from structid.study.schema.study_file import study_content

    content = study_content(folder / STUDY) if (folder / STUDY).is_file() else {}
    if is_programme(content):
        finish_programme(programme_report_again(folder, stage))
    elif is_cyclic_test(content):
        finish_cyclic_test(cyclic_report_again(folder, stage))
    else:
        finish(report_again(folder, stage))
