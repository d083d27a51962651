"""From a study file's words to somebody's solver: a Python file, a program, a server."""

from __future__ import annotations

import functools
import importlib.util
import sys
from pathlib import Path
from typing import Any

import cloudpickle

from structid.errors import InputError, suggestion
from structid.models.external import CallableModel, ExternalModel
from structid.models.program import OutputFile, ProgramModel
from structid.models.um_bridge import UMBridgeModel
from structid.probability.space import ParameterSpace
from structid.study.schema import ExternalSection, ProgramSection, PythonSection, UMBridgeSection


def external_model(section: ExternalSection, space: ParameterSpace, folder: Path) -> ExternalModel:
    """Build the model of an external solver.

    Parameters
    ----------
    section : ExternalSection
        What the file says.
    space : ParameterSpace
        The unknown parameters; all of them, derived ones included, are the solver's unless the file names some.
    folder : Path
        Where relative paths start.

    Returns
    -------
    ExternalModel
        The model.

    Raises
    ------
    InputError
        If a file or a name is not there.
    """
    free = section.parameters or space.all_names
    for name in free:
        if name not in space.all_names:
            raise InputError(
                "key 'model.parameters'", f"'{name}'", ", ".join(space.all_names), suggestion(name, space.all_names)
            )
    if isinstance(section, PythonSection):
        return _python(section, free, folder)
    if isinstance(section, ProgramSection):
        return _program(section, free, folder)
    assert isinstance(section, UMBridgeSection)
    return UMBridgeModel(
        section.url,
        free,
        section.channels,
        section.model,
        section.config,
        section.send_record,
        section.time_limit,
        section.version,
    )


def _python(section: PythonSection, free: tuple[str, ...], folder: Path) -> CallableModel:
    path = (folder / section.source).resolve()
    if not path.is_file():
        raise InputError(
            "key 'model.source'", f"there is no file {path}", "a Python file; its path starts at the study's folder"
        )
    module = _imported(path)
    function = getattr(module, section.function, None)
    if not callable(function):
        known = [n for n, v in vars(module).items() if callable(v) and getattr(v, "__module__", "") == module.__name__]
        raise InputError(
            "key 'model.function'", f"{path.name} has no function '{section.function}'", ", ".join(known) or "a function",
            suggestion(section.function, known),
        )  # fmt: skip
    return CallableModel(function, free, section.channels, section.time_limit, version=section.version)


@functools.cache
def _imported(path: Path) -> Any:
    """Import a file as a module that is sent to other processes whole, since they may not find it."""
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # for what it imports from beside it
    specification = importlib.util.spec_from_file_location(f"structid_study_{path.stem}", path)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = module
    try:
        specification.loader.exec_module(module)
    except Exception as problem:
        raise InputError(
            "key 'model.source'",
            f"{path.name} cannot be imported: {type(problem).__name__}: {problem}",
            "a Python file that runs",
        ) from problem
    cloudpickle.register_pickle_by_value(module)
    return module


def _program(section: ProgramSection, free: tuple[str, ...], folder: Path) -> ProgramModel:
    columns = section.output.columns
    if section.channels and set(section.channels) != set(columns):
        raise InputError("key 'model.channels'", ", ".join(section.channels), f"nothing, or {', '.join(columns)}")
    return ProgramModel(
        section.command,
        free,
        OutputFile(section.output.path, columns, section.output.units, section.output.time),
        section.templates,
        section.record_file,
        section.constants,
        section.copies,
        folder,
        keep=section.keep,
        environment=section.environment,
        time_limit=section.time_limit,
        version=section.version,
    )
