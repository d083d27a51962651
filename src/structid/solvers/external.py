"""Somebody's solver as a model: one run at a time, guarded against crashing and hanging, every end of it a row with a status."""

from __future__ import annotations

import builtins
import functools
import inspect
import os
import shutil
import threading
import time
import traceback
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np

from structid.errors import CampaignStoppedError, InputError, Status
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.journal import digest, function_identity
from structid.models.face import Map, Model, Progress
from structid.reasons import with_words
from structid.solvers.watchdog import LAST_WORDS, CallDiedError, CallTimeoutError, NotLoadedError, Watchdog

STANDARD_OUTPUT = "output.txt"
"""What a program says is kept in this file of its scratch folder."""

Solver = Callable[..., Any]
"""``f(parameters, record) -> histories``, or ``f(parameters, record, seed)``."""


@dataclass(frozen=True)
class Task:
    """One run to be done.

    Parameters
    ----------
    parameters : dict of str to float
        In SI, by name.
    name : str
        What its scratch folder is called.
    seed : int
        Of a solver that draws random numbers; the same for the same run on any executor.
    attempt : int
        Which attempt at the run this is.
    """

    parameters: dict[str, float]
    name: str
    seed: int
    attempt: int = 1


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one run.

    Parameters
    ----------
    values : ndarray, shape (time, channel)
        What it produced in SI; NaN where it produced nothing.
    status : Status
        How it ended.
    reason : str
        Why, if it did not reach its end.
    failure_time : float
        Time from which there is nothing [s], NaN for a run that is done.
    seconds : float
        Wall time.
    """

    values: np.ndarray
    status: Status = Status.DONE
    reason: str = ""
    failure_time: float = float("nan")
    seconds: float = 0.0


class SolverError(Exception):
    """A solver did not do its work; raised by a solver that knows it, with what it has so far.

    Parameters
    ----------
    reason : str
        What went wrong, in words.
    values : array-like, optional
        What it produced before, shape (time,) or (time, channel).
    """

    def __init__(self, reason: str, values: Any = None) -> None:
        super().__init__(reason, values)
        self.reason, self.values = str(reason), values


class ExternalModel(Model):
    """A model that is run one row at a time by a solver that is not structid's own.

    A subclass says how one run is done (`solve`) and what its results depend on (`content_hash`). The rest is here: a child
    process for the run, its time limit, the check of what came back.

    Parameters
    ----------
    free : sequence of str
        Names of the parameters, as the solver knows them.
    channels : sequence of str
        What the solver returns, in this order.
    time_limit : float, optional
        Seconds a run may take.
    isolated : bool
        Run in a child process, which can be killed and may crash. Without it a run happens in the calling process: easier to
        debug, and for functions that cannot be sent to another process; there is no time limit then.
    version : str
        Change it when something changes that `content_hash` cannot see, such as a library the solver calls: stored runs of another
        version are not taken for this one's.
    """

    def __init__(
        self,
        free: Sequence[str],
        channels: Sequence[str],
        time_limit: float | None = None,
        isolated: bool = True,
        version: str = "",
    ) -> None:
        self.version = version
        self.free = (free,) if isinstance(free, str) else tuple(free)
        self.channels = (channels,) if isinstance(channels, str) else tuple(channels)
        if len(set(self.channels)) < len(self.channels) or not self.channels:
            raise InputError(f"{type(self).__name__}.channels", f"{list(self.channels)}", "one name or more, each once")
        if time_limit is not None and not time_limit > 0:
            raise InputError(f"{type(self).__name__}.time_limit", f"{time_limit}", "a positive number of seconds")
        if time_limit is not None and not isolated:
            raise InputError(
                f"{type(self).__name__}.time_limit", "it is given with isolated=False", "one of the two",
                "Only a process of its own can be stopped.",
            )  # fmt: skip
        self.time_limit, self.isolated = time_limit, isolated

    scratch: Path | None = None
    """Where runs leave their files, if they do."""
    keeps_failed: bool = True
    """Whether the files of a run that failed stay."""
    kept: Path | None = None
    """Where the last run's files are, if they were kept; known to the process that did it."""

    @abstractmethod
    def solve(self, task: Task, excitation: Excitation) -> Any:
        """Do one run; called in the child process.

        Parameters
        ----------
        task : Task
            What to run.
        excitation : Excitation
            What drives it.

        Returns
        -------
        array-like, shape (time,) or (time, channel); mapping of str to array-like; or Histories
            In SI, at the excitation's samples. Numbers that are not finite mean that the run diverged there.

        Raises
        ------
        SolverError
            If the solver failed.
        """

    def run(
        self,
        theta: np.ndarray,
        excitation: Excitation,
        progress: Progress | None = None,
        map: Map | None = None,
    ) -> Histories:
        """Run rows of parameters one by one; see `Model.run`.

        Parameters
        ----------
        theta : ndarray, shape (run, parameter)
            Parameters in SI, in the order of `free`.
        excitation : Excitation
            What drives it.
        progress : callable, optional
            Told how many runs are done.
        map : callable, optional
            Spreads the runs, like ``Executor.map``; one after another when left out.

        Returns
        -------
        Histories
            With status and reason of every run.
        """
        call = packed(self, excitation)
        tasks = [self.task(row, excitation) for row in theta]
        outcomes = []
        for outcome in (map or builtins.map)(functools.partial(attempt, call), tasks):
            outcomes.append(outcome)
            if progress is not None:
                progress(len(outcomes), len(tasks))
        return Histories(
            np.stack([o.values for o in outcomes]),
            excitation.dt,
            self.channels,
            np.array([o.status for o in outcomes]),
            np.array([o.failure_time for o in outcomes]),
            excitation.name,
            tuple(o.reason for o in outcomes),
        )

    def task(self, row: np.ndarray, excitation: Excitation, attempts: int = 1) -> Task:
        """Describe one run.

        Parameters
        ----------
        row : ndarray, shape (parameter,)
            Parameters in SI, in the order of `free`.
        excitation : Excitation
            What drives it.
        attempts : int
            Which attempt at it this is.

        Returns
        -------
        Task
            Its name and seed depend on parameters, excitation and model alone.
        """
        key = digest(np.asarray(row, dtype=np.float64), excitation.content_hash, self.content_hash)
        parameters = {name: float(value) for name, value in zip(self.free, row, strict=True)}
        return Task(parameters, f"run-{key}", int(key[:8], 16), attempts)


@dataclass(frozen=True)
class PackedCall:
    """A model on an excitation, ready to be sent to wherever it is run.

    Parameters
    ----------
    key : str
        Stands for model and excitation.
    function : bytes or callable
        Maps a `Task` to an `Outcome`; pickled when the run is isolated.
    time_limit : float or None
        Seconds a run may take.
    shape : tuple of int
        Samples and channels of a run.
    scratch : str
        Where runs leave their files, empty if they leave none.
    keeps : bool
        Whether those of a run that failed stay.
    """

    key: str
    function: Any
    time_limit: float | None
    shape: tuple[int, int]
    scratch: str = ""
    keeps: bool = True


def packed(model: ExternalModel, excitation: Excitation) -> PackedCall:
    """Pack a model and an excitation for `attempt`.

    Parameters
    ----------
    model : ExternalModel
        The model.
    excitation : Excitation
        What drives it.

    Returns
    -------
    PackedCall
        To be pickled or not, as the executor likes.

    Raises
    ------
    InputError
        If the model cannot be sent to another process.
    """
    function: Any = functools.partial(_solved, model, excitation)
    if model.isolated:
        try:
            function = cloudpickle.dumps(function)
        except Exception as cause:
            raise InputError(
                f"{type(model).__name__}",
                f"it cannot be sent to another process ({cause})",
                "a function that can be pickled",
                "Open files, sockets and engines inside the function, or give isolated=False.",
            ) from None
    key = digest(model.content_hash, excitation.content_hash, function if isinstance(function, bytes) else "")
    shape = (len(excitation), len(model.channels))
    scratch = "" if model.scratch is None else str(model.scratch)
    return PackedCall(key, function, model.time_limit, shape, scratch, model.keeps_failed)


_guards = threading.local()


def guard_of_this_thread() -> Watchdog:
    """Return the child process that does this thread's runs.

    Returns
    -------
    Watchdog
        Its owner; made with the first call.
    """
    guard: Watchdog | None = getattr(_guards, "watchdog", None)
    if guard is None or _guards.process != os.getpid():  # a forked worker must not share its parent's child
        guard = _guards.watchdog = Watchdog()
        _guards.process = os.getpid()
    return guard


def attempt(call: PackedCall, task: Task) -> Outcome:
    """Do one run, guarded; every executor calls this.

    Parameters
    ----------
    call : PackedCall
        Model and excitation.
    task : Task
        What to run.

    Returns
    -------
    Outcome
        Always: a crash, a hang and an exception are outcomes too.
    """
    if not isinstance(call.function, bytes):
        here: Outcome = call.function(task)
        return here
    began = time.perf_counter()
    guard = guard_of_this_thread()
    nothing = np.full(call.shape, np.nan)
    kept = f" [kept: {call.scratch}/{task.name}-{task.attempt}-*]" if call.scratch and call.keeps else ""
    try:
        outcome: Outcome = guard.call(call.key, call.function, (task,), call.time_limit)
    except NotLoadedError as problem:
        raise CampaignStoppedError(str(problem)) from None
    except CallTimeoutError as limit:
        reason = with_words(str(limit), _left_behind(call, task)) + kept
        return Outcome(nothing, Status.TIMED_OUT, reason, 0.0, call.time_limit or 0.0)
    except CallDiedError as death:
        return Outcome(nothing, Status.FAILED, f"{death}{kept}", 0.0, time.perf_counter() - began)
    except Exception as problem:  # what it returned could not be pickled
        return Outcome(nothing, Status.FAILED, f"{type(problem).__name__}: {problem}", 0.0, time.perf_counter() - began)
    if outcome.status == Status.FAILED:
        outcome = replace(outcome, reason=with_words(outcome.reason, guard.last_words()))
    return outcome


def _left_behind(call: PackedCall, task: Task) -> str:
    """What a program said before it was stopped, which is in its scratch folder."""
    for folder in Path(call.scratch).glob(f"{task.name}-{task.attempt}-*") if call.scratch else ():
        words = (folder / STANDARD_OUTPUT).read_bytes()[-LAST_WORDS:] if (folder / STANDARD_OUTPUT).is_file() else b""
        if not call.keeps:
            shutil.rmtree(folder, ignore_errors=True)
        if words.strip():
            return words.decode(errors="replace").strip()
    return ""


def _solved(model: ExternalModel, excitation: Excitation, task: Task) -> Outcome:
    """Run the solver, in the child, and judge what it returned."""
    began = time.perf_counter()
    try:
        outcome = judged(model.solve(task, excitation), excitation, model.channels)
    except SolverError as failure:
        partial = None if failure.values is None else judged(failure.values, excitation, model.channels)
        outcome = _failed(failure.reason, excitation, model.channels, partial)
    except Exception as problem:
        outcome = _failed(_where(problem), excitation, model.channels)
    kept = f" [kept: {model.kept}]" if model.kept is not None and outcome.status != Status.DONE else ""
    return replace(outcome, reason=outcome.reason + kept, seconds=time.perf_counter() - began)


def _where(problem: Exception) -> str:
    """Say what was raised and in which line of whose file."""
    frames = traceback.extract_tb(problem.__traceback__)
    place = f" ({os.path.basename(frames[-1].filename)}, line {frames[-1].lineno})" if frames else ""  # noqa: PTH119
    return f"{type(problem).__name__}: {problem}{place}"


def _failed(reason: str, excitation: Excitation, channels: tuple[str, ...], partial: Outcome | None = None) -> Outcome:
    values = np.full((len(excitation), len(channels)), np.nan) if partial is None else partial.values
    good = np.isfinite(values).all(axis=1)
    reached = len(good) if good.all() else int(np.argmin(good))
    return Outcome(values, Status.FAILED, reason, min(reached, len(good) - 1) * excitation.dt)


def judged(result: Any, excitation: Excitation, channels: tuple[str, ...]) -> Outcome:
    """Hold what a solver returned against what it should have: shape, length, finite numbers.

    Parameters
    ----------
    result : Any
        What came.
    excitation : Excitation
        What drove it.
    channels : tuple of str
        What was asked for.

    Returns
    -------
    Outcome
        Done; diverged from the first number that is not finite; or failed, with what is wrong and what is there.
    """
    samples = len(excitation)
    wanted = f"{samples} rows of {', '.join(channels)}"
    nothing = np.full((samples, len(channels)), np.nan)
    if result is None:
        return Outcome(nothing, Status.FAILED, f"it returned nothing; wanted {wanted}", 0.0)
    try:
        columns = _columns(result, channels)
    except (ValueError, TypeError, KeyError) as problem:
        return Outcome(nothing, Status.FAILED, f"{problem}; wanted {wanted}", 0.0)
    if len(columns) == 0:
        return Outcome(nothing, Status.FAILED, f"it returned no rows; wanted {wanted}", 0.0)
    values = nothing
    values[: len(columns)] = columns[:samples]
    finite = np.isfinite(values[: len(columns)]).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        values[first:] = np.nan
        t = first * excitation.dt
        return Outcome(values, Status.DIVERGED, f"not finite from {t:g} s on", t)
    if len(columns) != samples:
        end = min(len(columns), samples - 1) * excitation.dt
        return Outcome(values, Status.FAILED, f"it returned {len(columns)} rows; wanted {wanted}", end)
    return Outcome(values)


def _columns(result: Any, channels: tuple[str, ...]) -> np.ndarray:
    if isinstance(result, Histories):
        result = {name: result.channel(name)[0] for name in result.channels}
    if isinstance(result, Mapping):
        missing = [c for c in channels if c not in result]
        if missing:
            raise KeyError(f"there is no '{missing[0]}' among the returned {', '.join(map(str, result)) or 'nothing'}")
        parts = [np.asarray(result[c], dtype=np.float64).ravel() for c in channels]
        if len({len(p) for p in parts}) > 1:
            raise ValueError(f"its channels have {', '.join(str(len(p)) for p in parts)} rows")
        return np.column_stack(parts)
    if np.iscomplexobj(result):
        raise TypeError("it returned complex numbers")
    array = np.asarray(result, dtype=np.float64)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.shape[1] != len(channels):
        raise ValueError(f"it returned an array of shape {np.shape(result)}")
    return array


class CallableModel(ExternalModel):
    """A Python function as a model.

    Parameters
    ----------
    function : callable
        ``function(parameters, record)``: parameters in SI by name, and the `Excitation`; returns the histories as an array
        (time,) or (time, channel), a dictionary by channel, or a `Histories` of one run. It may raise anything; `SolverError`
        carries what was done so far. If it has an argument ``seed``, it is given one.
    free, channels
        As for `ExternalModel`.
    time_limit : float, optional
        Seconds a run may take.
    isolated, version
        See `ExternalModel`. What the function's code, and what it uses of its own module, says counts in any case.

    Examples
    --------
    >>> import numpy as np
    >>> from structid.ground_motion.record import GroundMotion
    >>> def falling(parameters, record):
    ...     return parameters["height"] - 0.5 * 9.81 * record.time**2
    >>> model = CallableModel(falling, free=("height",), channels=("displacement",), isolated=False)
    >>> model.simulate(np.array([[10.0]]), GroundMotion(np.zeros(3), 1.0)).values[0, :, 0].tolist()
    [10.0, 5.095, -9.620000000000001]
    """

    def __init__(
        self,
        function: Solver,
        free: Sequence[str],
        channels: Sequence[str],
        time_limit: float | None = None,
        isolated: bool = True,
        version: str = "",
    ) -> None:
        super().__init__(free, channels, time_limit, isolated, version)
        if not callable(function):
            raise InputError("CallableModel.function", f"{function!r}", "a function of (parameters, record)")
        self.function = function
        self._seeded = "seed" in _argument_names(function)

    def solve(self, task: Task, excitation: Excitation) -> Any:
        """Call the function; see `ExternalModel.solve`.

        Parameters
        ----------
        task : Task
            What to run.
        excitation : Excitation
            What drives it.

        Returns
        -------
        Any
            What it returns.
        """
        extra = {"seed": task.seed} if self._seeded else {}
        return self.function(dict(task.parameters), excitation, **extra)

    @functools.cached_property
    def content_hash(self) -> str:
        """Hash of the function's code, the names and the version."""
        return digest("callable", function_identity(self.function), self.free, self.channels, self.version)

    def __repr__(self) -> str:
        name = getattr(self.function, "__name__", type(self.function).__name__)
        return f"CallableModel({name}: {', '.join(self.free)} -> {', '.join(self.channels)})"


def _argument_names(function: Solver) -> list[str]:
    try:
        return list(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        return []
