"""Interface between models and external solvers: the task, the outcome, the errors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from structid.core.errors import Status
from structid.ground_motion.excitation import Excitation

STANDARD_OUTPUT = "output.txt"
"""File in the scratch folder with the program's output."""


@dataclass(frozen=True)
class Task:
    """One run to be done."""

    parameters: dict[str, float]  # in SI, by name
    name: str  # name of its scratch folder
    seed: int  # seed of a stochastic solver; the same for the same run on any executor
    attempt: int = 1  # number of this attempt


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of one run."""

    values: Float[np.ndarray, "time channel"]  # results in SI; NaN where there are none
    status: Status = Status.DONE  # how it ended
    reason: str = ""  # why, unless it reached its end
    failure_time: float = float("nan")  # time from which there is no response [s]; NaN for a completed run
    seconds: float = 0.0  # wall time


class SolverError(Exception):
    """A solver could not do its work. A solver that notices this raises it, with what it has so far.

    Parameters
    ----------
    reason : str
        What went wrong, in words.
    values : array-like, optional
        What it produced before, shape (time,) or (time, channel).

    Examples
    --------
    >>> import structid as si
    >>> def solve(parameters, record):
    ...     if parameters["stiffness"] <= 0.0:
    ...         raise si.SolverError("the stiffness is not positive")
    ...     return parameters["stiffness"] * record.values
    """

    def __init__(self, reason: str, values: Any = None) -> None:
        super().__init__(reason, values)
        self.reason, self.values = str(reason), values


class StructureFailedError(SolverError):
    """The structure failed: it collapsed, or passed a limit beyond which it is lost.

    Raised by a solver that did its work. The run is data, and is not tried again. A run that failed, by contrast, says nothing
    about the structure.

    Parameters
    ----------
    reason : str
        How it failed, in words, such as ``"drift beyond 5 %"``.
    values : array-like, optional
        The response until then, shape (time,) or (time, channel).

    Examples
    --------
    >>> import structid as si
    >>> def solve(parameters, record):
    ...     drift = record.values / parameters["stiffness"]
    ...     if abs(drift).max() > 0.05:
    ...         raise si.StructureFailedError("the storey drift exceeds 5 %")
    ...     return drift
    """


class Solver(Protocol):
    """An external solver from the guard's viewpoint: one run at a time, from parameters and excitation."""

    channels: tuple[str, ...]  # channels that a run returns
    time_limit: float | None  # time limit of a run [s]
    isolated: bool  # whether a run happens in a child process
    scratch: Path | None  # folder for files of runs, if there are any
    keeps_failed: bool  # whether the files of a failed run are kept
    kept: Path | None  # folder of the last run's files, if kept; known only to the process that did the run
    preloaded: str  # module that a child process imports before the first run, so that a new one starts in milliseconds

    @property
    def content_hash(self) -> str:
        """Hash of everything a response depends on besides parameters and excitation."""

    def solve(self, task: Task, excitation: Excitation) -> Any:
        """Do one run, in the child process."""
