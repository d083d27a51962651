"""An external solver as a model, with one run at a time and protection against crashes and hangs. Every run gets a status."""

from __future__ import annotations

import builtins
import functools
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np
from jaxtyping import Float

from structid.core.channels import ChannelUnit, declared_unit, standard_unit
from structid.core.errors import InputError, check_choice
from structid.core.hashing import digest
from structid.core.progress import Progress
from structid.core.validation import check_name
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.models.base import Map, Model
from structid.models.external.guard import attempt, packed
from structid.models.external.protocol import Task


class ExternalModel(Model):
    """A model whose runs are computed one at a time by a solver outside structid.

    A subclass implements one run (`solve`) and the hash of all data on which its results depend (`content_hash`). This class
    adds the child process, the time limit and the check of the result.
    """

    guarded: ClassVar[bool] = True
    preloaded = __name__

    def __init__(
        self,
        free: Sequence[str],
        channels: Sequence[str],
        time_limit: float | None = None,
        isolated: bool = True,
        version: str = "",
        units: Mapping[str, str] | None = None,
    ) -> None:
        self.version = version
        self.free = (free,) if isinstance(free, str) else tuple(free)
        self.channels = (channels,) if isinstance(channels, str) else tuple(channels)
        for what, names in (("free", self.free), ("channels", self.channels)):
            for name in names:
                check_name(f"{type(self).__name__}.{what}", name)
        if len(set(self.channels)) < len(self.channels) or not self.channels:
            raise InputError(f"{type(self).__name__}.channels", f"{list(self.channels)}", "one or more different names")
        if time_limit is not None and not time_limit > 0:
            raise InputError(f"{type(self).__name__}.time_limit", f"{time_limit}", "a positive number of seconds")
        if time_limit is not None and not isolated:
            raise InputError(
                f"{type(self).__name__}.time_limit",
                "a time limit is given with isolated=False",
                "either a time limit or isolated=False",
                "Remove one of the two, since only a run in a child process can be stopped.",
            )
        self.time_limit, self.isolated = time_limit, isolated
        for name in units or {}:
            check_choice(f"{type(self).__name__}.units", name, self.channels)
        self._units = {name: declared_unit(name, unit) for name, unit in (units or {}).items()}

    @property
    def channel_units(self) -> dict[str, ChannelUnit]:
        """SI unit and display unit of every channel, either declared or defined by its standard name."""
        return {c: self._units.get(c, standard_unit(c)) for c in self.channels}

    scratch: Path | None = None
    """Folder for the files of runs, if they write files."""
    keeps_failed: bool = True
    """Whether the files of a failed run are kept."""
    kept: Path | None = None
    """Folder with the files of the last run, if they were kept; set only in the process of the run."""

    @abstractmethod
    def solve(self, task: Task, excitation: Excitation) -> Any:
        """Carry out one run, in the child process."""

    def run(
        self,
        theta: Float[np.ndarray, "run parameter"],
        excitation: Excitation,
        progress: Progress | None = None,
        map: Map | None = None,
    ) -> Histories:
        """Run rows of parameters one by one; see `Model.run`."""
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
            self.channel_units,
        )

    def task(self, row: Float[np.ndarray, " parameter"], excitation: Excitation, attempts: int = 1) -> Task:
        """Describe one run."""
        key = digest(np.asarray(row, dtype=np.float64), excitation.content_hash, self.content_hash)
        parameters = {name: float(value) for name, value in zip(self.free, row, strict=True)}
        return Task(parameters, f"run-{key}", int(key[:8], 16), attempts)


def as_guarded(model: Model) -> ExternalModel:
    """Return a model with ``guarded = True`` as an `ExternalModel`, for type checkers."""
    return cast(ExternalModel, model)
