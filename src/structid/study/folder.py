"""The folder of a study: the identity of the study, and copies of its input files."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from structid.campaign.store import CALIBRATION_FINISHED, CALIBRATION_FOLDER, CAMPAIGN_RUNS
from structid.core.errors import InputError, StoreMismatchError, undamaged
from structid.core.journal import compare_identity, differences, write_then_rename
from structid.study.build_study import build
from structid.study.building.built_study import BuiltStudy
from structid.study.folder_layout import CHAINS, IDENTITY, INPUTS, STUDY
from structid.study.kept_inputs import keep_inputs, with_kept_names
from structid.study.schema.study_file import StudyFile, study_text
from structid.study.stages import stage_list
from structid.study.study_reader import parse_study, stands_alone


def _has_runs(folder: Path) -> bool:
    stores = [table.store for table in stage_list.tables()]
    return any((folder / name).is_file() for name in (CAMPAIGN_RUNS, *stores))


def has_draws(folder: Path) -> bool:
    """Whether the folder contains draws from a sampler or from a certified calibration."""
    return (folder / CHAINS).is_file() or (folder / CALIBRATION_FOLDER / CALIBRATION_FINISHED).is_file()


def stored_study(folder: Path) -> tuple[StudyFile, dict[str, Any]]:
    """Read the study in a folder; its file names refer to the copies of the input files."""
    identity = folder / IDENTITY
    if not identity.is_file() or not (has_draws(folder) or _has_runs(folder)):
        raise InputError(
            f"{folder}",
            "it contains no finished study",
            "an output folder of structid run",
            "Finish the study first: structid run STUDY.toml --out DIR --resume.",
        )
    with undamaged(identity, "the identity of a study"):
        identity_of_study = json.loads(identity.read_text(encoding="utf-8"))
    return _with_kept_inputs(folder, identity_of_study["inputs"]), identity_of_study


def rebuilt(folder: Path, file: StudyFile, identity: dict[str, Any]) -> BuiltStudy:
    """Rebuild the study that was sampled in a folder."""
    if not (has_draws(folder) or (stands_alone(file) and not file.observation)):
        raise InputError(
            f"{folder}",
            "its sampling has not started",
            "the folder of a finished study",
            "Finish the study first: structid run STUDY.toml --out DIR --resume.",
        )
    study = build(file, folder / INPUTS, Path(identity["folder"]))
    compare_identity(folder, identity["study"], study.identity)
    return study


def claim(folder: Path, study: BuiltStudy, path: Path, resume: bool, adopt: bool) -> None:
    """Reserve a folder for this study, or reject the folder and leave it unchanged."""
    identity_file = folder / IDENTITY
    if identity_file.is_file():
        with undamaged(identity_file, "the identity of a study"):
            stored = json.loads(identity_file.read_text(encoding="utf-8"))["study"]
        if not (adopt and differences(stored, study.identity) == ["model"]):
            compare_identity(folder, stored, study.identity)
        if not resume:
            raise InputError(
                f"--out {folder}",
                "it already contains this study",
                "an empty or new folder",
                "Add --resume to continue the study, or choose another folder.",
            )
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(
            f"--out {folder}",
            "it is not empty and contains no study",
            "an empty or new folder",
            "Choose another folder.",
        )
    folder.mkdir(parents=True, exist_ok=True)
    if path.resolve() != (folder / STUDY).resolve():
        write_then_rename(folder / STUDY, study_text(path).encode())
    inputs = keep_inputs(study.file.model_dump(), study.folder, folder)
    identity = {
        "study": study.identity,
        "name": study.file.name,
        "inputs": inputs,
        "folder": str(study.folder),
    }
    write_then_rename(identity_file, json.dumps(identity, indent=2).encode())


@contextmanager
def left_as_it_was(folder: Path) -> Iterator[None]:
    """Restore the identity of a folder if its stores belong to another study."""
    kept = {name: (folder / name).read_bytes() for name in (IDENTITY, STUDY) if (folder / name).is_file()}
    try:
        yield
    except StoreMismatchError:
        for name, content in kept.items():
            write_then_rename(folder / name, content)
        raise


def _with_kept_inputs(folder: Path, inputs: dict[str, str]) -> StudyFile:
    """Read the stored study; its file names refer to the copies of the input files."""
    path = folder / STUDY
    return parse_study(with_kept_names(tomllib.loads(path.read_text(encoding="utf-8")), inputs), str(path))
