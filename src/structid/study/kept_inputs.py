"""Copies of input files in an output folder, so that a report can be rewritten where the originals have moved."""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from structid.core.errors import InputError
from structid.core.journal import write_then_rename
from structid.study.folder_layout import INPUTS, STUDY
from structid.study.schema.study_file import study_content, study_text

NAMES = "names.json"
"""New names of the input files, in the folder of the copies."""

WITHOUT_COPIES = ("model", "specimen", "structure")
"""Tables whose files are programs, or are read where they lie."""


def keep_inputs(content: Mapping[str, Any], source: Path, folder: Path) -> dict[str, str]:
    """Copy all input files of a study into its folder; return the new name of each file."""
    kept: dict[str, str] = {}
    for name in dict.fromkeys(_file_names({k: v for k, v in content.items() if k not in WITHOUT_COPIES})):
        # A name with .. or an absolute name would lie outside the folder.
        kept[name] = f"{len(kept)}/{Path(name).name}"
        target = folder / INPUTS / kept[name]
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target)
    return kept


def _file_names(content: Any) -> Iterator[str]:
    """All values of the key ``file``, at any depth."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            if key == "file" and isinstance(value, str):
                yield value
            else:
                yield from _file_names(value)
    elif isinstance(content, (list, tuple)):
        for value in content:
            yield from _file_names(value)


def with_kept_names(content: Any, names: Mapping[str, str]) -> Any:
    """Return the content of a study whose file names refer to the copies."""
    if isinstance(content, dict):
        return {
            k: names.get(v, v) if k == "file" and isinstance(v, str) else with_kept_names(v, names)
            for k, v in content.items()
        }
    return [with_kept_names(v, names) for v in content] if isinstance(content, list) else content


def claim_for_text(folder: Path, path: Path, resume: bool, what: str) -> None:
    """Reserve a folder for a file, with its text and its inputs, or reject the folder."""
    kept, text = folder / STUDY, study_text(path)
    if kept.is_file():
        if study_text(kept) != text:
            raise InputError(f"{folder}", f"it contains another {what}", f"a new folder, or the same {what} file")
        if not resume:
            raise InputError(
                f"{folder}", f"it already contains this {what}", "a new folder", "Add --resume to continue it."
            )
        return
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder}", "it is not empty", "a new or an empty folder")
    (folder / INPUTS).mkdir(parents=True, exist_ok=True)
    names = keep_inputs(tomllib.loads(text), path.resolve().parent, folder)
    write_then_rename(folder / INPUTS / NAMES, json.dumps(names, indent=2).encode())
    write_then_rename(kept, text.encode())


def kept_content(folder: Path) -> dict[str, Any]:
    """Read the tables of the file in a folder; its file names refer to the copies in the folder."""
    names = folder / INPUTS / NAMES
    content = study_content(folder / STUDY)
    kept: dict[str, Any] = with_kept_names(content, json.loads(names.read_text()) if names.is_file() else {})
    return kept
