"""What a solver is asked, what it answers, and how it says that something went wrong."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from structid.core.errors import Status
from structid.ground_motion.excitation import Excitation

STANDARD_OUTPUT = "output.txt"
"""File in the scratch folder that keeps what a program says."""


@dataclass(frozen=True)
class Task:
    """One run to be done."""

    parameters: dict[str, float]  # In SI, by name
    name: str  # Name of its scratch folder
    seed: int  # For a solver that draws random numbers; the same for the same run on any executor
    attempt: int = 1  # Number of this attempt at the run


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one run."""

    values: Float[np.ndarray, "time channel"]  # What it produced in SI; NaN where it produced nothing
    status: Status = Status.DONE  # How it ended
    reason: str = ""  # Why, if it did not reach its end
    failure_time: float = float("nan")  # Time from which there is no response [s]; NaN for a run that is done
    seconds: float = 0.0  # Wall time


class SolverError(Exception):
    """A solver could not do its work. A solver that notices this raises it, with what it has so far.

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
    """


class Solver(Protocol):
    """An external solver as the guard sees it: one run at a time, from parameters and excitation."""

    channels: tuple[str, ...]  # What a run returns
    time_limit: float | None  # Seconds a run may take
    isolated: bool  # Whether a run happens in a child process
    scratch: Path | None  # Where runs leave their files, if they leave any
    keeps_failed: bool  # Whether the files of a failed run are kept
    kept: Path | None  # Where the last run's files are, if they were kept. Known only to the process that did the run
    preloaded: str  # Module that a child process imports before the first run, so that a new one starts in milliseconds

    @property
    def content_hash(self) -> str:
        """Hash of everything a response depends on besides parameters and excitation."""

    def solve(self, task: Task, excitation: Excitation) -> Any:
        """Do one run; called in the child process."""
