"""One guarded run: a crash, a hang or an exception becomes an outcome of the run."""

from __future__ import annotations

import functools
import os
import shutil
import threading
import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np

from structid.core.errors import CampaignStoppedError, InputError, Status
from structid.core.hashing import digest
from structid.core.reasons import with_words
from structid.ground_motion.excitation import Excitation
from structid.models.external.protocol import STANDARD_OUTPUT, Outcome, Solver, SolverError, StructureFailedError, Task
from structid.models.external.returned import check_result, failed
from structid.models.external.watchdog import LAST_WORDS, CallDiedError, CallTimeoutError, NotLoadedError, Watchdog


@dataclass(frozen=True)
class PackedCall:
    """A model and an excitation, ready to be sent to a worker."""

    key: str  # identifies model and excitation
    function: Any  # maps a `Task` to an `Outcome`; pickled for an isolated run
    time_limit: float | None  # time limit of a run [s]
    shape: tuple[int, int]  # samples and channels of a run
    scratch: str = ""  # folder for files of runs; empty if there are none
    keeps: bool = True  # whether the files of a failed run are kept
    preloaded: str = ""  # module that a child process imports before its first run


def packed(model: Solver, excitation: Excitation) -> PackedCall:
    """Pack a model and an excitation for `attempt`."""
    function: Any = functools.partial(_solved, model, excitation)
    if model.isolated:
        try:
            function = cloudpickle.dumps(function)
        except Exception as cause:
            raise InputError(
                f"{type(model).__name__}",
                f"the model cannot be sent to another process ({cause})",
                "a function that can be pickled",
                "Open files and connections inside the function, or use isolated=False.",
            ) from None
    key = digest(model.content_hash, excitation.content_hash, function if isinstance(function, bytes) else "")
    shape = (len(excitation), len(model.channels))
    scratch = "" if model.scratch is None else str(model.scratch)
    return PackedCall(key, function, model.time_limit, shape, scratch, model.keeps_failed, model.preloaded)


_guards = threading.local()


def guard_of_this_thread() -> Watchdog:
    """Return the watchdog for the runs of this thread."""
    guard: Watchdog | None = getattr(_guards, "watchdog", None)
    if guard is None or _guards.process != os.getpid():  # a forked worker must not share its parent's child
        guard = _guards.watchdog = Watchdog()
        _guards.process = os.getpid()
    return guard


def attempt(call: PackedCall, task: Task) -> Outcome:
    """Carry out one guarded run; every executor calls this function."""
    if not isinstance(call.function, bytes):
        here: Outcome = call.function(task)
        return here
    began = time.perf_counter()
    guard = guard_of_this_thread()
    nothing = np.full(call.shape, np.nan)
    kept = f" [kept: {call.scratch}/{task.name}-{task.attempt}-*]" if call.scratch and call.keeps else ""
    try:
        outcome: Outcome = guard.call(call.key, call.function, (task,), call.time_limit, call.preloaded)
    except NotLoadedError as problem:
        raise CampaignStoppedError(str(problem)) from None
    except CallTimeoutError as limit:
        reason = with_words(str(limit), _left_behind(call, task)) + kept
        return Outcome(nothing, Status.TIMED_OUT, reason, 0.0, call.time_limit or 0.0)
    except CallDiedError as death:
        return Outcome(nothing, Status.FAILED, f"{death}{kept}", 0.0, time.perf_counter() - began)
    except Exception as problem:  # the returned value could not be pickled
        return Outcome(nothing, Status.FAILED, f"{type(problem).__name__}: {problem}", 0.0, time.perf_counter() - began)
    if outcome.status == Status.FAILED:
        outcome = replace(outcome, reason=with_words(outcome.reason, guard.last_words()))
    return outcome


def _left_behind(call: PackedCall, task: Task) -> str:
    """Return what a program printed before it was stopped, from its scratch folder."""
    for folder in Path(call.scratch).glob(f"{task.name}-{task.attempt}-*") if call.scratch else ():
        words = (folder / STANDARD_OUTPUT).read_bytes()[-LAST_WORDS:] if (folder / STANDARD_OUTPUT).is_file() else b""
        if not call.keeps:
            shutil.rmtree(folder, ignore_errors=True)
        if words.strip():
            return words.decode(errors="replace").strip()
    return ""


def _solved(model: Solver, excitation: Excitation, task: Task) -> Outcome:
    """Run the solver in the child process and check its result."""
    began = time.perf_counter()
    try:
        outcome = check_result(model.solve(task, excitation), excitation, model.channels)
    except StructureFailedError as end:
        outcome = failed(end.reason, excitation, model.channels, end.values, Status.STRUCTURE_FAILED)
    except SolverError as failure:
        outcome = failed(failure.reason, excitation, model.channels, failure.values)
    except Exception as problem:
        outcome = failed(_where(problem), excitation, model.channels, None)
    complete = outcome.status in (Status.DONE, Status.STRUCTURE_FAILED)
    kept = f" [kept: {model.kept}]" if model.kept is not None and not complete else ""
    return replace(outcome, reason=outcome.reason + kept, seconds=time.perf_counter() - began)


def _where(problem: Exception) -> str:
    """Describe an exception with its file and line."""
    frames = traceback.extract_tb(problem.__traceback__)
    location = f" ({os.path.basename(frames[-1].filename)}, line {frames[-1].lineno})" if frames else ""  # noqa: PTH119
    return f"{type(problem).__name__}: {problem}{location}"
