"""A Python function as a model."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from structid.core.errors import InputError
from structid.core.hashing import digest, function_identity
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.models.external.external import ExternalModel
from structid.models.external.protocol import Task

SolverFunction = Callable[..., Any]
"""``f(parameters, record) -> histories``, or ``f(parameters, record, seed)``."""


@check_arguments
class CallableModel(ExternalModel):
    """A Python function as a model.

    Parameters
    ----------
    function : callable
        ``function(parameters, record)`` with parameters in SI by name, and the `Excitation`. It returns the histories as an
        array (time,) or (time, channel), a dictionary by channel, or a `Histories` of one run. It may raise any exception;
        a `SolverError` can contain partial histories. A function with an argument ``seed`` receives a seed.
    free, channels
        See `ExternalModel`.
    time_limit : float, optional
        Time limit of a run [s].
    isolated, version, units
        See `ExternalModel`. The hash includes the function and the code that it uses from its own
        module; `version` covers other code.

    Examples
    --------
    >>> import structid as si
    >>> import numpy as np
    >>> def falling(parameters, record):
    ...     return parameters["height"] - 0.5 * 9.81 * record.time**2
    >>> model = si.CallableModel(falling, free=("height",), channels=("displacement",), isolated=False)
    >>> model.simulate(np.array([[10.0]]), si.GroundMotion(np.zeros(3), 1.0)).values[0, :, 0].tolist()
    [10.0, 5.095, -9.620000000000001]
    """

    def __init__(
        self,
        function: SolverFunction,
        free: Sequence[str],
        channels: Sequence[str],
        time_limit: float | None = None,
        isolated: bool = True,
        version: str = "",
        units: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(free, channels, time_limit, isolated, version, units)
        if not callable(function):
            raise InputError("CallableModel.function", f"{function!r}", "a function of (parameters, record)")
        self.function = function
        self._seeded = "seed" in _argument_names(function)

    def solve(self, task: Task, excitation: Excitation) -> Any:
        """Call the function; see `ExternalModel.solve`."""
        extra = {"seed": task.seed} if self._seeded else {}
        return self.function(dict(task.parameters), excitation, **extra)

    @functools.cached_property
    def content_hash(self) -> str:
        """Hash of the function's code, the names and the version."""
        return digest("callable", function_identity(self.function), self.free, self.channels, self.version)

    def __repr__(self) -> str:
        name = getattr(self.function, "__name__", type(self.function).__name__)
        return f"CallableModel({name}: {', '.join(self.free)} -> {', '.join(self.channels)})"


def _argument_names(function: SolverFunction) -> list[str]:
    try:
        return list(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        return []
