"""A program as a model: a command line, input files from templates, and histories from its output file."""

from __future__ import annotations

import copy
import functools
import os
import re
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from jaxtyping import Float

from structid.core.channels import declared_unit
from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.reasons import with_words
from structid.core.units import factor
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.models.external.external import ExternalModel
from structid.models.external.keeper import ended_by
from structid.models.external.protocol import STANDARD_OUTPUT, SolverError, StructureFailedError, Task
from structid.models.external.watchdog import LAST_WORDS


@check_arguments
@dataclass(frozen=True)
class OutputFile:
    """The file in which a program writes its histories.

    Parameters
    ----------
    file : str
        Name in the scratch folder. ``.h5``, ``.hdf5`` and ``.nc`` mean HDF5; any other extension means text columns.
    columns : mapping of str to int or str
        For each channel: the column, counted from 0, or its name in the file's header. In HDF5: the path of the dataset.
    units : mapping of str to str
        Units of the columns; SI by default.
    time : int or str, optional
        Column of the times [s]. If it is given, the histories are interpolated linearly to the record's samples.
        Otherwise the file must have a row for every sample.

    Examples
    --------
    >>> import structid as si
    >>> output = si.OutputFile("drift.out", columns={"drift": 1}, units={"drift": "mm"}, time=0)
    >>> output.file
    'drift.out'
    """

    file: str
    columns: Mapping[str, int | str]
    units: Mapping[str, str] = field(default_factory=dict)
    time: int | str | None = None

    def __post_init__(self) -> None:
        for channel, unit in self.units.items():
            if channel not in self.columns:
                raise InputError("OutputFile.units", f"a unit for '{channel}'", ", ".join(self.columns))
            declared_unit(channel, unit)


@check_arguments
class ProgramModel(ExternalModel):
    """A program as a model; each run takes place in its own scratch folder.

    Command and templates are jinja2 templates. Available names are every parameter (in SI; ``{{ stiffness | unit("kN/mm") }}``
    gives another unit), every constant, ``record`` (``name``, ``dt``, ``samples``, ``values`` in SI), ``folder`` (with the
    model's files), ``cores`` (1) and ``seed``. Any other name is an error.

    Parameters
    ----------
    command : str or sequence of str
        The program and its arguments. The command runs in the scratch folder, without a shell.
    free : sequence of str
        Names of the parameters.
    output : OutputFile
        Output file with the histories.
    templates : mapping of str to path-like
        Input files to create: their names in the scratch folder, and their templates.
    record_file : str, optional
        Name of a file for the record, with one value per line in SI.
    constants : mapping, optional
        Additional names for the templates.
    copies : sequence of path-like
        Files to copy into the scratch folder unchanged.
    folder : path-like
        Folder at which relative paths start.
    scratch : path-like, optional
        Folder for the scratch folders; by default the system's temporary folder.
    keep : {"failed", "all", "none"}
        Scratch folders to keep.
    environment : mapping of str to str, optional
        Additional environment variables.
    time_limit : float, optional
        Time limit of a run [s].
    version : str
        See `ExternalModel`. Set it for a program outside `folder`, since the hash does not include its content.
    structure_failed_exit_code : int, optional
        Exit code by which the program reports that the structure failed; see `StructureFailedError`. Any other nonzero exit
        code means a failed run.

    Examples
    --------
    >>> import structid as si
    >>> drift = si.OutputFile("drift.out", columns={"drift": 1}, units={"drift": "mm"})
    >>> inputs = {"frame.tcl": "frame.tcl.in"}
    >>> model = si.ProgramModel("opensees frame.tcl", ("stiffness",), drift, templates=inputs)  # doctest: +SKIP
    """

    scratch: Path

    def __init__(
        self,
        command: str | Sequence[str],
        free: Sequence[str],
        output: OutputFile,
        templates: Mapping[str, str | os.PathLike[str]] | None = None,
        record_file: str | None = None,
        constants: Mapping[str, Any] | None = None,
        copies: Sequence[str | os.PathLike[str]] = (),
        folder: str | os.PathLike[str] = ".",
        scratch: str | os.PathLike[str] | None = None,
        keep: str = "failed",
        environment: Mapping[str, str] | None = None,
        time_limit: float | None = None,
        version: str = "",
        structure_failed_exit_code: int | None = None,
    ) -> None:
        super().__init__(free, tuple(output.columns), time_limit, version=version, units=output.units)
        if structure_failed_exit_code == 0:
            raise InputError("ProgramModel.structure_failed_exit_code", "0", "a nonzero exit code")
        self.structure_failed_exit_code = structure_failed_exit_code
        if keep not in ("failed", "all", "none"):
            raise InputError("ProgramModel.keep", f"'{keep}'", "'failed', 'all' or 'none'")
        self.folder = Path(folder).resolve()
        self.command = command if isinstance(command, str) else shlex.join(command)
        self.output, self.record_file, self.keep = output, record_file, keep
        self.keeps_failed = keep != "none"
        self.constants, self.environment = dict(constants or {}), dict(environment or {})
        self.template_files = dict(templates or {})
        self.templates = {name: self._text(path) for name, path in self.template_files.items()}
        self.copies = tuple(self._existing(path) for path in copies)
        self.scratch = Path(scratch) if scratch is not None else Path(tempfile.gettempdir()) / f"structid-{os.getuid()}"
        self._check_templates()

    def working_in(self, folder: Path) -> ProgramModel:
        """Return this model with another location for its scratch folders."""
        other = copy.copy(self)
        other.scratch = folder
        return other

    def _existing(self, path: str | os.PathLike[str]) -> Path:
        result = self.folder / path
        if not result.is_file():
            raise InputError(
                f"{result}",
                "there is no such file",
                "a file in the study's folder",
                "Correct the path, which is relative to the study's folder.",
            )
        return result

    def _text(self, path: str | os.PathLike[str]) -> str:
        return self._existing(path).read_text(encoding="utf-8")

    def _check_templates(self) -> None:
        """Render all templates once with all parameters equal to one, to find misspelt names before the first run."""
        names = self._sample_names()
        where = {"command": "the command", **{name: f"template {path}" for name, path in self.template_files.items()}}
        for name, text in {"command": self.command, **self.templates}.items():
            try:
                _rendered(text, names)
            except jinja2.UndefinedError as problem:
                allowed = ", ".join([*self.free, *self.constants, "record", "folder", "cores", "seed"])
                cure = "Correct the name, or add a constant of this name."
                raise InputError(where[name], f"{problem}", allowed, cure) from None
            except jinja2.TemplateError as problem:
                line = f", line {problem.lineno}" if isinstance(problem, jinja2.TemplateSyntaxError) else ""
                raise InputError(f"{where[name]}{line}", f"{problem}", "a jinja2 template") from None

    @functools.cached_property
    def content_hash(self) -> str:
        """Hash of command, templates and constants, and of the content of copied files and of files named in the command."""
        names = self._sample_names()
        words = [_rendered(word, names) for word in split_command(self.command)]
        named = [self.folder / (shutil.which(words[0]) or words[0]), *(self.folder / word for word in words[1:])]
        files = [path for path in (*self.copies, *named) if path.is_file()]
        contents = [(path.name, digest(path.read_bytes().hex())) for path in files]
        output = [self.output.file, dict(self.output.columns), dict(self.output.units), self.output.time]
        return digest(
            "program",
            self.command,
            self.templates,
            self.constants,
            self.environment,
            self.free,
            output,
            self.record_file,
            contents,
            self.version,
            *([self.structure_failed_exit_code] if self.structure_failed_exit_code else []),
        )

    def solve(self, task: Task, excitation: Excitation) -> np.ndarray:
        """Run the program in a fresh scratch folder; see `ExternalModel.solve`."""
        scratch = self._fresh_folder(task)
        complete = False
        try:
            values = self._solve_in(scratch, task, excitation)
            complete = bool(len(values) == len(excitation) and np.isfinite(values).all())
            return values
        finally:
            stays = self.keep == "all" or (self.keep == "failed" and not complete)
            self.kept = scratch if stays else None
            if not stays:
                shutil.rmtree(scratch, ignore_errors=True)

    def _fresh_folder(self, task: Task) -> Path:
        self.scratch.mkdir(parents=True, exist_ok=True)
        if self.keep != "all":
            for earlier in range(1, task.attempt):
                for left in self.scratch.glob(f"{task.name}-{earlier}-*"):
                    shutil.rmtree(left, ignore_errors=True)
        return Path(tempfile.mkdtemp(prefix=f"{task.name}-{task.attempt}-", dir=self.scratch))

    def _solve_in(self, scratch: Path, task: Task, excitation: Excitation) -> np.ndarray:
        names = self._names(task, excitation)
        for path in self.copies:
            shutil.copy(path, scratch / path.name)
        for name, text in self.templates.items():
            target = scratch / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(_rendered(text, names), encoding="utf-8")
        if self.record_file is not None:
            np.savetxt(scratch / self.record_file, excitation.values, fmt="%.17g")
        # Split the command first, because a folder's name may contain spaces.
        command = [_rendered(word, names) for word in split_command(self.command)]
        output = scratch / STANDARD_OUTPUT
        try:
            with output.open("wb") as voice:
                ended = subprocess.run(
                    command,
                    cwd=scratch,
                    stdin=subprocess.DEVNULL,
                    stdout=voice,
                    stderr=subprocess.STDOUT,
                    env={**os.environ, **self.environment},
                    check=False,
                )
        except OSError as problem:
            raise SolverError(f"'{command[0]}' could not be started: {problem.strerror}") from None
        if ended.returncode != 0:
            words = output.read_bytes()[-LAST_WORDS:].decode(errors="replace").strip()
            if ended.returncode == self.structure_failed_exit_code:
                reason = with_words("the structure failed", words)
                raise StructureFailedError(reason, self._what_there_is(scratch, excitation))
            raise SolverError(with_words(ended_by(ended.returncode), words), self._what_there_is(scratch, excitation))
        return read_output(scratch, self.output, excitation)

    def _what_there_is(self, scratch: Path, excitation: Excitation) -> np.ndarray | None:
        """Return partial histories of a program that failed; they are kept, but never used as a result."""
        try:
            return read_output(scratch, self.output, excitation)
        except SolverError:
            return None

    def _names(self, task: Task, excitation: Excitation) -> dict[str, Any]:
        """Return the names available in command and templates."""
        record = {
            "name": excitation.name,
            "dt": excitation.dt,
            "samples": len(excitation),
            "values": excitation.values.tolist(),
        }
        builtins = {"seed": task.seed, "record": record, "folder": str(self.folder), "cores": 1}
        return {**self.constants, **task.parameters, **builtins}

    def _sample_names(self) -> dict[str, Any]:
        """Return the names for templates with all parameters equal to one, for checks."""
        return self._names(Task(dict.fromkeys(self.free, 1.0), "check", 0), Excitation(np.zeros(2), 0.01, "check"))

    def __repr__(self) -> str:
        return f"ProgramModel({self.command}: {', '.join(self.free)} -> {', '.join(self.channels)})"


def split_command(command: str) -> list[str]:
    """Split a command line into words like a shell, but keep text between double braces in one piece."""
    pieces: list[str] = []

    def put_aside(found: re.Match[str]) -> str:
        pieces.append(found.group())
        return f"\x00{len(pieces) - 1}\x00"

    words = shlex.split(re.sub(r"\{\{.*?\}\}", put_aside, command))
    return [re.sub(r"\x00(\d+)\x00", lambda found: pieces[int(found.group(1))], word) for word in words]


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, keep_trailing_newline=True, autoescape=False)
    environment.filters["unit"] = lambda value, unit: value / factor(unit)
    # With seventeen digits, the program receives a parameter exactly, to the last bit.
    environment.finalize = lambda value: f"{value:.17g}" if isinstance(value, float) else value
    return environment


def _rendered(text: str, names: Mapping[str, Any]) -> str:
    return _environment().from_string(text).render(**names)


def read_output(scratch: Path, output: OutputFile, excitation: Excitation) -> Float[np.ndarray, "time channel"]:
    """Read the histories written by a program."""
    path = scratch / output.file
    if not path.is_file():
        there = ", ".join(sorted(p.name for p in scratch.iterdir())) or "nothing"
        raise SolverError(f"the program wrote no '{output.file}'; its folder contains {there}")
    reader = _read_hdf5 if path.suffix in (".h5", ".hdf5", ".nc") else _read_text
    columns_to_read = [*output.columns.values(), *([] if output.time is None else [output.time])]
    columns = reader(path, columns_to_read)
    values = np.column_stack(
        [
            column * factor(output.units.get(channel, ""))
            for channel, column in zip(output.columns, columns, strict=False)
        ]
    )
    return values if output.time is None else _at_samples(columns[-1], values, excitation, output.file)


def _read_text(path: Path, wanted: list[int | str]) -> list[np.ndarray]:
    lines = [line for line in path.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    header: list[str] = []
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        if line.lstrip().startswith("#") and not rows:
            header = re.split(r"[,;\s]+", line.strip(" #\t"))
            continue
        words = [w.strip() for w in re.split(r"[,;\s]+" if "," not in line else ",", line.strip().lstrip("#").strip())]
        try:
            rows.append([_number(w) for w in words])
        except ValueError:
            if rows:
                raise SolverError(f"line {number} of '{path.name}' is not numeric: {line[:80]!r}", None) from None
            header = words
    if not rows:
        raise SolverError(f"'{path.name}' contains no numbers")
    # An incomplete last row is dropped; any other row with a different length is an error.
    if len(rows) > 1 and len(rows[-1]) < len(rows[0]):
        rows.pop()
    odd = next((i for i, row in enumerate(rows) if len(row) != len(rows[0])), None)
    if odd is not None:
        raise SolverError(f"row {odd + 1} of '{path.name}' has {len(rows[odd])} columns, not {len(rows[0])}")
    table = np.array(rows)
    return [table[:, _column(key, header, table.shape[1], path.name)] for key in wanted]


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return float(word.upper().replace("D", "E"))  # Fortran's 0.1D+02


def _column(key: int | str, header: list[str], width: int, name: str) -> int:
    if isinstance(key, str):
        if key not in header:
            raise SolverError(f"'{name}' has no column '{key}'; its header has {', '.join(header) or 'no names'}")
        return header.index(key)
    if not -width <= key < width:
        raise SolverError(f"'{name}' has {width} columns, so there is no column {key} (counted from 0)")
    return key


def _read_hdf5(path: Path, wanted: list[int | str]) -> list[np.ndarray]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            missing = [k for k in wanted if k not in file]
            if missing:
                raise SolverError(f"'{path.name}' has no dataset '{missing[0]}'; it contains {', '.join(file)}")
            columns = [np.asarray(file[key], dtype=np.float64).ravel() for key in wanted]
    except OSError as problem:
        raise SolverError(f"'{path.name}' cannot be opened as HDF5: {problem}") from None
    if len({len(c) for c in columns}) > 1:
        raise SolverError(f"the datasets of '{path.name}' have {', '.join(str(len(c)) for c in columns)} rows")
    return columns


def _at_samples(times: np.ndarray, values: np.ndarray, excitation: Excitation, name: str) -> np.ndarray:
    """Interpolate histories from the program's times to the record's samples, up to the program's last time."""
    if not (np.diff(times) > 0).all():
        raise SolverError(f"the times in '{name}' do not increase")
    tolerance = 1e-6 * excitation.dt
    reached = excitation.time[excitation.time <= times[-1] + tolerance]
    if times[0] > tolerance:
        raise SolverError(f"the times in '{name}' begin at {times[0]:g} s, but the record begins at 0")
    return np.column_stack([np.interp(reached, times, column) for column in values.T])
