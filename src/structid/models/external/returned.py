"""Checks of a solver's result: shape, length, finite numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from structid.core.errors import InputError, Status
from structid.core.validation import real_array
from structid.ground_motion.excitation import Excitation
from structid.histories import Histories
from structid.models.external.protocol import Outcome


def check_result(result: Any, excitation: Excitation, channels: tuple[str, ...]) -> Outcome:
    """Check the shape, the length and the finiteness of a solver's result."""
    samples = len(excitation)
    expected = f"{samples} rows of {', '.join(channels)}"
    nothing = np.full((samples, len(channels)), np.nan)
    if result is None:
        return Outcome(nothing, Status.FAILED, f"the solver returned nothing; expected {expected}", 0.0)
    try:
        columns = _columns(result, channels)
    except (ValueError, TypeError, KeyError) as problem:
        return Outcome(nothing, Status.FAILED, f"{problem.args[0]}; expected {expected}", 0.0)
    if len(columns) == 0:
        return Outcome(nothing, Status.FAILED, f"the solver returned no rows; expected {expected}", 0.0)
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
        return Outcome(values, Status.FAILED, f"the solver returned {len(columns)} rows; expected {expected}", end)
    return Outcome(values)


def failed(
    reason: str, excitation: Excitation, channels: tuple[str, ...], partial: Any, status: Status = Status.FAILED
) -> Outcome:
    """Build the outcome of a run that ended early, with its results until then."""
    values = (
        np.full((len(excitation), len(channels)), np.nan)
        if partial is None
        else check_result(partial, excitation, channels).values
    )
    good = np.isfinite(values).all(axis=1)
    reached = len(good) if good.all() else int(np.argmin(good))
    return Outcome(values, status, reason, min(reached, len(good) - 1) * excitation.dt)


def _columns(result: Any, channels: tuple[str, ...]) -> np.ndarray:
    if isinstance(result, Histories):
        result = {name: result.channel(name)[0] for name in result.channels}
    if isinstance(result, Mapping):
        missing = [c for c in channels if c not in result]
        if missing:
            raise KeyError(f"the solver returned {', '.join(map(str, result)) or 'no channels'}, but no '{missing[0]}'")
        parts = [_real(f"its channel '{c}' holds", result[c]).ravel() for c in channels]
        if len({len(p) for p in parts}) > 1:
            raise ValueError(f"its channels have {', '.join(str(len(p)) for p in parts)} rows")
        return np.column_stack(parts)
    array = _real("the solver returned", result)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.shape[1] != len(channels):
        raise ValueError(f"the solver returned an array of shape {np.shape(result)}")
    return array


def _real(what: str, value: Any) -> np.ndarray:
    """Convert a result to an array of numbers; raise a `ValueError` that describes any other content."""
    try:
        return real_array(what, value)
    except InputError as problem:
        raise ValueError(f"{what} {problem.came}") from None
