"""structid compare: compare model classes on one measurement."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.screen import NOT_CONVERGED, print_plainly, print_table, screen, stage


def compare(
    folders: Annotated[list[Path], typer.Argument(help="Folders of finished studies of the same measurement.")],
    out: Annotated[Path | None, typer.Option(help="Folder for a page that compares their predictions.")] = None,
) -> None:
    """Compare model classes on one measurement: evidence, Bayes factors, prediction of held-out segments."""
    from structid.study.compare import compare_studies

    comparison, page = compare_studies(folders, out, stage)
    trusted = all(c.trusted for c in comparison.classes)
    screen.print()
    print_plainly(comparison.verdict, style="green" if trusted else "bold red")
    heads, rows = comparison.rows()
    print_table(heads, rows)
    if page is not None:
        print_plainly(f"\nPage: {page.resolve()}")
    if not trusted:
        raise typer.Exit(NOT_CONVERGED)
