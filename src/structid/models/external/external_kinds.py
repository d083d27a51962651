"""External solvers that a study file can name: a Python file, a program, a server."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from structid.core.errors import InputError, suggestion
from structid.core.keys import FileTable, Seconds
from structid.models.external.callable import CallableModel
from structid.models.external.function_in_file import FunctionInFile, imported
from structid.models.external.program import OutputFile, ProgramModel
from structid.models.external.um_bridge import UMBridgeModel
from structid.models.hysteretic.hysteretic_parameters import parameter_unit
from structid.models.model_kind import ModelKind, ModelRequest


class OutputTable(FileTable):
    """The file in which a program writes its histories; see `OutputFile`."""

    path: str
    columns: dict[str, int | str] = Field(min_length=1)
    units: dict[str, str] = Field(default_factory=dict)
    time: int | str | None = None


_EVERY: dict[str, tuple[Any, Any]] = {
    "channels": (tuple[str, ...], ...),
    "parameters": (tuple[str, ...], None),
    "time_limit": (Annotated[Seconds, Field(gt=0)], None),
    "version": (str, ""),
}
"""Keys common to all external solvers."""


def _names(asked: ModelRequest) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the parameters of the solver (by default all parameters of the study) and its channels."""
    available = asked.space.all_names
    free = asked.given.get("parameters") or available
    for name in free:
        if name not in available:
            raise InputError("key 'model.parameters'", f"'{name}'", ", ".join(available), suggestion(name, available))
    return tuple(free), tuple(asked.given["channels"])


def _limits(asked: ModelRequest) -> dict[str, Any]:
    return {"time_limit": asked.given.get("time_limit"), "version": asked.given["version"]}


def _python(asked: ModelRequest) -> CallableModel:
    name = asked.given["function"]
    path = (asked.folder / asked.given["source"]).resolve()
    if not path.is_file():
        raise InputError(
            "key 'model.source'", f"there is no file {path}", "a path from the study's folder to a Python file"
        )
    module = imported(path)
    if not callable(getattr(module, name, None)):
        functions = [
            n for n, v in vars(module).items() if callable(v) and getattr(v, "__module__", "") == module.__name__
        ]
        raise InputError(
            "key 'model.function'",
            f"{path.name} has no function '{name}'",
            ", ".join(functions) or "a function",
            suggestion(name, functions),
        )
    function = FunctionInFile(path, name)
    return CallableModel(function, *_names(asked), units=asked.given["units"], **_limits(asked))


def _program(asked: ModelRequest) -> ProgramModel:
    given, output = asked.given, asked.given["output"]
    free, channels = _names(asked)
    columns = output["columns"]
    if channels and set(channels) != set(columns):
        raise InputError("key 'model.channels'", ", ".join(channels), f"no key, or {', '.join(columns)}")
    return ProgramModel(
        given["command"],
        free,
        OutputFile(output["path"], columns, output["units"], output["time"]),
        given["templates"],
        given.get("record_file"),
        given["constants"],
        given["copies"],
        asked.folder,
        keep=given["keep"],
        environment=given["environment"],
        structure_failed_exit_code=given.get("structure_failed_exit_code"),
        **_limits(asked),
    )


def _served(asked: ModelRequest) -> UMBridgeModel:
    given = asked.given
    return UMBridgeModel(
        given["url"],
        *_names(asked),
        name=given["model"],
        config=given["config"],
        send_record=given["send_record"],
        units=given["units"],
        **_limits(asked),
    )


_UNITS: dict[str, tuple[Any, Any]] = {"units": (dict[str, str], {})}
"""Units of channels with non-standard names; a program declares them with its output."""

PYTHON = ModelKind(
    "python",
    {**_EVERY, **_UNITS, "source": (str, ...), "function": (str, "respond")},
    _python,
    parameter_unit=parameter_unit,
)
PROGRAM = ModelKind(
    "program",
    {
        **_EVERY,
        "channels": (tuple[str, ...], ()),
        "command": (str, ...),
        "output": (OutputTable, ...),
        "templates": (dict[str, str], {}),
        "record_file": (str, None),
        "constants": (dict[str, float | str], {}),
        "copies": (tuple[str, ...], ()),
        "keep": (Literal["failed", "all", "none"], "failed"),
        "environment": (dict[str, str], {}),
        "structure_failed_exit_code": (int, None),
    },
    _program,
    parameter_unit=parameter_unit,
)
UMBRIDGE = ModelKind(
    "umbridge",
    {
        **_EVERY,
        **_UNITS,
        "url": (str, ...),
        "model": (str, "forward"),
        "config": (dict[str, Any], {}),
        "send_record": (bool, False),
    },
    _served,
    parameter_unit=parameter_unit,
)
