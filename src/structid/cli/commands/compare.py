"""structid compare: compare model classes on one measurement."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.screen import NOT_CONVERGED, print_table, screen, stage


def compare(
    folders: Annotated[list[Path], typer.Argument(help="Folders of finished studies of the same measurement.")],
    out: Annotated[Path | None, typer.Option(help="Folder for a page that compares their predictions.")] = None,
) -> None:
    """Compare model classes on one measurement: evidence, Bayes factors, prediction of held-out segments."""
    from structid.study.compare import compare_studies

    comparison, page = compare_studies(folders, out, stage)
    trusted = all(c.trusted for c in comparison.classes)
    screen.print()
    screen.print(comparison.verdict, style="green" if trusted else "bold red", markup=False, soft_wrap=True)
    heads, rows = comparison.rows()
    print_table(heads, rows)
    if page is not None:
        screen.print(f"\nPage: {page.resolve()}", markup=False, soft_wrap=True)
    if not trusted:
        raise typer.Exit(NOT_CONVERGED)
