"""Excitations of a model: signals with a constant time step. The type of a signal defines its action on the model."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.errors import InputError, check_choice
from structid.core.hashing import digest
from structid.core.validation import check_arguments


def checked_signal(where: str, values: object, dt: float) -> tuple[np.ndarray, float]:
    """Check a signal and make it read-only: one dimension, finite, at least two samples, a positive step."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or array.size < 2:
        raise InputError(where, f"an array of shape {array.shape}", "one dimension and at least two samples")
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise InputError(
            where,
            f"{bad.size} values that are not finite, the first at sample {bad[0]}",
            "finite numbers",
            "Cut or repair the signal first.",
        )
    if not (np.isfinite(dt) and dt > 0):
        raise InputError(f"{where}: dt", f"{dt}", "a positive number of seconds")
    array.setflags(write=False)
    return array, float(dt)


@dataclass(frozen=True, eq=False)
class Excitation:
    """A signal with a constant time step; the subclass defines its action on a model."""

    values: np.ndarray  # The samples in SI
    dt: float  # Time step [s]
    name: str = ""  # Name of the signal
    # Interpolation: straight lines, a cubic spline, or a Fourier series with the samples as one period. The relative error
    # of straight lines at frequency ω is (ω dt)²/12. For a smooth force with 20 samples per period it is 0.8 %, and 0.0014 %
    # for a spline. Ground motions are straight lines by convention
    interpolation: str = "linear"
    # With ``periodic``: number of initial periods that are computed and dropped, so that the response is the steady
    # state
    lead_in_periods: int = 0

    kind: ClassVar[str] = "excitation"
    unit: ClassVar[str] = ""
    display_unit: ClassVar[str] = ""

    def __post_init__(self) -> None:
        array, dt = checked_signal(f"{type(self).__name__} '{self.name}'", self.values, self.dt)
        check_choice(f"{type(self).__name__}.interpolation", self.interpolation, ("linear", "smooth", "periodic"))
        if self.lead_in_periods and self.interpolation != "periodic":
            raise InputError(
                "lead_in_periods",
                f"{self.lead_in_periods} with {self.interpolation} interpolation",
                "0",
                "Only a periodic signal can have lead-in periods.",
            )
        if self.lead_in_periods < 0:
            raise InputError("lead_in_periods", f"{self.lead_in_periods}", "0 or more")
        object.__setattr__(self, "values", array)
        object.__setattr__(self, "dt", dt)

    def __len__(self) -> int:
        return len(self.values)

    @property
    def signals(self) -> tuple[Excitation, ...]:
        """The individual signals: this signal, or the parts of a combination."""
        return (self,)

    @property
    def time(self) -> np.ndarray:
        """Times of the samples [s], shape (time,)."""
        return np.arange(len(self)) * self.dt

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return (len(self) - 1) * self.dt

    @functools.cached_property
    def content_hash(self) -> str:
        """Hash of all data on which a response depends."""
        return digest(self.kind, self.values, self.dt, self.interpolation, self.lead_in_periods)

    def to_plain(self) -> dict[str, Any]:
        """Describe the signal without its samples, JSON-compatible."""
        return {
            "kind": self.kind,
            "dt": self.dt,
            "name": self.name,
            "interpolation": self.interpolation,
            "lead_in_periods": self.lead_in_periods,
        }

    def stage_values(self, substeps: int) -> np.ndarray:
        """Return the signal at the start, middle and end of every integration step."""
        samples = self.values.size
        if self.interpolation == "periodic":
            fine = scipy.signal.resample(self.values, samples * 2 * substeps)
            steps = samples * self.lead_in_periods + samples - 1
            grid = np.take(fine, np.arange(steps * 2 * substeps + 1), mode="wrap")
        else:
            steps = samples - 1
            places = np.arange(steps * 2 * substeps + 1) / (2 * substeps)
            if self.interpolation == "smooth":
                grid = scipy.interpolate.CubicSpline(np.arange(samples), self.values)(places)
            else:
                grid = np.interp(places, np.arange(samples), self.values)
        stages = np.stack([grid[0:-2:2], grid[1:-1:2], grid[2::2]], axis=1)
        return stages.reshape(steps, substeps, 3)

    @check_arguments
    def values_at(self, times: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """Return the signal at arbitrary times within its duration."""
        if self.interpolation == "periodic":
            raise InputError(
                f"{type(self).__name__} '{self.name}'", "a periodic signal", "linear or smooth interpolation"
            )
        latest = float(np.max(times, initial=0.0))
        if latest > self.duration * (1.0 + 1e-9):
            came = f"the time {latest:g} s is after the end"
            raise InputError(f"{type(self).__name__} '{self.name}'", came, f"times up to {self.duration:g} s")
        if self.interpolation == "smooth":
            return np.asarray(scipy.interpolate.CubicSpline(self.time, self.values)(times))
        return np.asarray(np.interp(times, self.time, self.values))

    @property
    def dropped_samples(self) -> int:
        """Number of lead-in samples, which are not part of a response."""
        return self.lead_in_periods * len(self)


@check_arguments
class ForceHistory(Excitation):
    """A force on the mass, or on the top storey of a frame [N].

    Parameters
    ----------
    values : array-like, shape (time,)
        Force [N].
    dt : float
        Time step [s].
    name, interpolation, lead_in_periods
        As for `Excitation`.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> push = si.ForceHistory(np.linspace(0.0, 5e4, 201), dt=0.01, name="push")
    >>> push.duration
    2.0
    """

    kind = "force"
    unit = "N"
    display_unit = "kN"


@check_arguments
class DisplacementHistory(Excitation):
    """An imposed displacement [m], as in a quasi-static cyclic test; the model returns the force.

    Parameters
    ----------
    values : array-like, shape (time,)
        Displacement [m].
    dt : float
        Time step [s]; it has no effect on a rate-independent model.
    name, interpolation, lead_in_periods
        As for `Excitation`.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> cycles = si.DisplacementHistory(0.02 * np.sin(np.arange(0.0, 20.5, 0.5)), dt=0.5, name="cyclic test")
    >>> cycles.duration
    20.0
    """

    kind = "displacement"
    unit = "m"
    display_unit = "mm"


@check_arguments
class RotationHistory(Excitation):
    """An imposed rotation [rad], combined with displacements in a `CombinedExcitation`; the model returns the moment.

    Parameters
    ----------
    values : array-like, shape (time,)
        Rotation [rad].
    dt : float
        Time step [s]; it has no effect on a rate-independent model.
    name, interpolation, lead_in_periods
        As for `Excitation`.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> turn = si.RotationHistory(np.linspace(0.0, 1e-3, 101), dt=0.01)
    >>> turn.duration
    1.0
    """

    kind = "rotation"
    unit = "rad"
    display_unit = "rad"


@check_arguments
class CombinedExcitation(Excitation):
    """Several signals that act together: two components of a ground motion, or a ground motion and a force.

    The built-in models take one signal. An external model receives ``values`` with a column for each signal. The terms of a
    NARX model name the signals ``x1``, ``x2``, ….

    Parameters
    ----------
    parts : sequence of Excitation
        Two or more signals with the same time step, length, interpolation and lead-in.
    name : str
        Name of the combination; by default the names of the parts, joined by "and".

    Attributes
    ----------
    values : ndarray, shape (time, part)
        The samples in SI.

    Raises
    ------
    InputError
        If the parts cannot be combined.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> across = si.DisplacementHistory(np.linspace(0.0, 0.01, 101), dt=0.01)
    >>> down = si.DisplacementHistory(np.linspace(0.0, -0.001, 101), dt=0.01)
    >>> both = si.CombinedExcitation((across, down))
    >>> both.values.shape
    (101, 2)
    """

    parts: tuple[Excitation, ...]

    def __init__(self, parts: Sequence[Excitation], name: str = "") -> None:
        signals = (parts,) if isinstance(parts, Excitation) else tuple(parts)
        if not isinstance(name, str):
            raise InputError("CombinedExcitation", "several arguments", "one list: CombinedExcitation([first, second])")
        for part in signals:
            if type(part) is CombinedExcitation or not isinstance(part, Excitation):
                raise InputError("CombinedExcitation", f"a {type(part).__name__}", "GroundMotion, ForceHistory, …")
        timings = {(p.dt, len(p), p.interpolation, p.lead_in_periods) for p in signals}
        if len(signals) < 2 or len(timings) > 1:
            raise InputError(
                "CombinedExcitation",
                f"{len(signals)} signals with {len(timings)} different time steps, lengths, interpolations or lead-ins",
                "two or more signals with equal properties",
                "Resample and trim the signals.",
            )
        values = np.stack([p.values for p in signals], axis=1)
        values.setflags(write=False)
        first = signals[0]
        fields = {
            "parts": signals,
            "values": values,
            "dt": first.dt,
            "name": name or " and ".join(p.name for p in signals),
            "interpolation": first.interpolation,
            "lead_in_periods": first.lead_in_periods,
        }
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    @property
    def signals(self) -> tuple[Excitation, ...]:
        """The parts."""
        return self.parts

    @property
    def kind(self) -> str:  # type: ignore[override]
        """Kinds of the parts."""
        return "+".join(p.kind for p in self.parts)

    def to_plain(self) -> dict[str, Any]:
        """Describe the signals without their samples, JSON-compatible."""
        return {"name": self.name, "parts": [p.to_plain() for p in self.parts]}

    def stage_values(self, substeps: int) -> np.ndarray:
        """Return the signals at the start, middle and end of every integration step."""
        return np.stack([p.stage_values(substeps) for p in self.parts], axis=-1)


def check_one_signal(where: str, excitation: Excitation) -> None:
    """Reject an excitation of several signals."""
    if isinstance(excitation, CombinedExcitation):
        raise InputError(
            where,
            f"{len(excitation.parts)} signals at once",
            "one GroundMotion, ForceHistory or DisplacementHistory",
            "Use an external model, or its surrogate, for several signals.",
        )


def check_signals_alike(where: str, records: Sequence[Excitation]) -> None:
    """Check that all records have the same number of signals."""
    counts = sorted({1 if r.values.ndim == 1 else r.values.shape[1] for r in records})
    if len(counts) > 1:
        came = f"records with {' and '.join(map(str, counts))} signals"
        raise InputError(where, came, "the same number of signals in each record")


def padded_values(records: Sequence[Excitation]) -> Float[np.ndarray, "record time *motion"]:
    """Return the samples of several records in one array, with NaN after the end of a shorter record."""
    table = np.full((len(records), max(map(len, records)), *records[0].values.shape[1:]), np.nan)
    for row, record in zip(table, records, strict=True):
        row[: len(record)] = record.values
    return table
