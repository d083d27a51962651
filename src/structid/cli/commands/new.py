"""structid new: a new study file from a template."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from structid.cli.screen import screen
from structid.core.errors import InputError, check_choice
from structid.study.packaged import SOLVERS, TEMPLATES, template


def new(
    name: Annotated[str, typer.Argument(help="Name of the study; NAME.toml is written here.")],
    like: Annotated[str, typer.Option(help=f"Packaged study to copy: {', '.join(TEMPLATES)}.")] = "measured",
    files: Annotated[
        list[Path] | None,
        typer.Option(
            "--from",
            help="File of the excitation, of a measured response or of a cyclic test; repeat it for several files.",
        ),
    ] = None,
) -> None:
    """Write a study file from a template, or for given data files."""
    check_choice("--like", like, TEMPLATES)
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    if path.exists():
        raise InputError(f"{path}", "the file already exists", "a new name", "Choose another name or remove the file.")
    if not path.parent.is_dir():
        raise InputError(
            f"{path}", f"the folder '{path.parent}' does not exist", "an existing folder", "Create the folder first."
        )
    solver = SOLVERS.get(like)
    if solver is not None and (path.parent / solver).exists():
        raise InputError(
            f"{path.parent / solver}", "the file already exists", "a folder without it", "Choose another folder."
        )
    text = template(like).replace(f'name = "{like}"', f'name = "{path.stem}"', 1)
    if files:
        text = _for_files(text, like, files, path.parent)
    path.write_text(text, encoding="utf-8")
    if solver is not None:
        (path.parent / solver).write_text(template(solver), encoding="utf-8")
        screen.print(f"Wrote {path.parent / solver}, an example solver. Replace it with yours.")
    screen.print(f"Wrote {path}. Edit it, then run: structid check {path}")


def _for_files(text: str, like: str, files: list[Path], folder: Path) -> str:
    """Put the tables for some files into the study of measured files, or into that of a cyclic test."""
    from structid.data_files.overview import look
    from structid.study.lines_for_files import cyclic_study_from_files, study_from_files

    if like not in ("measured", "cyclic"):
        raise InputError(
            "--from",
            f"--like {like}",
            "--like measured, the study of measured files, or --like cyclic",
            "Leave --like out.",
        )
    # A study names files relative to its own folder.
    named = [
        replace(look(file), path=str(file) if file.is_absolute() else os.path.relpath(file, folder)) for file in files
    ]
    return study_from_files(text, named) if like == "measured" else cyclic_study_from_files(text, named)
