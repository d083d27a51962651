"""From a study file's words to somebody's solver: a Python file, a program, a server."""

from __future__ import annotations

import ast
import functools
import importlib.util
import sys
from pathlib import Path
from typing import Any

from structid.errors import InputError, suggestion
from structid.journal import digest
from structid.probability.space import ParameterSpace
from structid.solvers.callable import CallableModel
from structid.solvers.external import ExternalModel
from structid.solvers.program import OutputFile, ProgramModel
from structid.solvers.um_bridge import UMBridgeModel
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
    module = imported(path)
    if not callable(getattr(module, section.function, None)):
        known = [n for n, v in vars(module).items() if callable(v) and getattr(v, "__module__", "") == module.__name__]
        raise InputError(
            "key 'model.function'", f"{path.name} has no function '{section.function}'", ", ".join(known) or "a function",
            suggestion(section.function, known),
        )  # fmt: skip
    function = FunctionInFile(path, section.function)
    return CallableModel(function, free, section.channels, section.time_limit, version=section.version)


class FunctionInFile:
    """A function that another process imports from its file, instead of being sent it.

    Parameters
    ----------
    path : Path
        The file, where every process finds it.
    name : str
        The function.
    """

    def __init__(self, path: Path, name: str) -> None:
        self.path, self.name = path, name
        self.__wrapped__ = getattr(imported(path), name)
        self.__name__ = name

    def __reduce__(self) -> Any:
        return (FunctionInFile, (self.path, self.name))

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Call the function."""
        return self.__wrapped__(*arguments, **keywords)

    @property
    def identity(self) -> str:
        """Hash of what its file says, and the files it imports from the same folder; comments and layout do not count."""
        folder = self.path.parent
        files = {self.path}
        for module in list(sys.modules.values()):
            file = getattr(module, "__file__", None)
            if file and file.endswith(".py") and Path(file).is_relative_to(folder) and "site-packages" not in file:
                files.add(Path(file))
        texts = {str(f.relative_to(folder)): ast.dump(ast.parse(f.read_text(encoding="utf-8"))) for f in sorted(files)}
        return digest(self.name, texts)


@functools.cache
def imported(path: Path) -> Any:
    """Import a file as a module; what lies beside it can be imported from it.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    module
        Imported once in a process.

    Raises
    ------
    InputError
        If it cannot be imported.
    """
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
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
