"""Interface between models and external solvers: task, outcome and errors."""

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
    """One run to be carried out."""

    parameters: dict[str, float]  # values in SI, by name
    name: str  # name of the scratch folder
    seed: int  # seed of a stochastic solver; for a given run it is equal on all executors
    attempt: int = 1  # number of this attempt


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of one run."""

    values: Float[np.ndarray, "time channel"]  # results in SI; NaN for missing results
    status: Status = Status.DONE  # how the run ended
    reason: str = ""  # reason of failure; empty for a completed run
    failure_time: float = float("nan")  # time from which there is no response [s]; NaN for a completed run
    seconds: float = 0.0  # wall time [s]


class SolverError(Exception):
    """Error that a solver raises if it cannot complete a run; it can contain the results so far.

    Parameters
    ----------
    reason : str
        Description of the failure.
    values : array-like, optional
        Results before the failure, shape (time,) or (time, channel).

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
    """Error that a solver raises if the structure failed: it collapsed, or exceeded a failure limit.

    The solver has worked correctly, so the run is data and is not repeated. A failed run, by contrast, contains no information
    about the structure.

    Parameters
    ----------
    reason : str
        Description of the structural failure, such as ``"drift beyond 5 %"``.
    values : array-like, optional
        The response until the failure, shape (time,) or (time, channel).

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
    """Interface of an external solver for the guard: one run at a time, from parameters and excitation."""

    channels: tuple[str, ...]  # channels that a run returns
    time_limit: float | None  # time limit of a run [s]
    isolated: bool  # whether a run takes place in a child process
    scratch: Path | None  # folder for files of runs, if there are any
    keeps_failed: bool  # whether the files of a failed run are kept
    kept: Path | None  # folder of the last run's files, if kept; set only in the process of the run
    preloaded: str  # module imported before the first run, so that new child processes start in milliseconds

    @property
    def content_hash(self) -> str:
        """Hash of all data on which a response depends, except parameters and excitation."""

    def solve(self, task: Task, excitation: Excitation) -> Any:
        """Carry out one run, in the child process."""
