"""Measured responses: excitation, values, and nuisance parameters of the instrument."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from structid.core.channels import ChannelUnit, declared_unit, standard_unit
from structid.core.errors import InputError, check_choice, suggestion
from structid.core.hashing import digest
from structid.core.units import factor
from structid.core.validation import check_arguments, check_name
from structid.data_files.read_file import read_signal
from structid.engine.array_module import namespace
from structid.ground_motion.excitation import Excitation
from structid.ground_motion.processing import between, pair_of_times, remove_offset, stretches
from structid.instrument import POLARITIES, Instrument, parameter_name
from structid.probability.truncation import Marginal
from structid.sensor_sampling import SensorSampling

NUISANCES = ("gain", "offset", "drift", "time_shift")
"""Nuisance parameters of an instrument."""
KNOWN_NUISANCES = {
    "gain": "Divide the values by a known gain; set polarity='reversed' if a sensor points in the opposite direction.",
    "offset": "Subtract a known offset from the values.",
    "drift": "Subtract a known drift from the values.",
    "time_shift": "Give a known shift to Observation.read, which shifts the values in time.",
}
"""Remedy if a nuisance parameter is known."""


SAME_STEP = 1e-6
"""Relative difference below which two time steps are equal."""

FEWEST_VALUES = 10
"""Smallest number of measured values of a channel."""

COMMON_SHARE = 0.5
"""Share of common values from which on two measurements may be copies."""

AT_ZERO = 1e-3
"""Time, in steps, below which the first time of a file is zero."""

ROUNDED = 5e-4
"""Difference relative to the peak below which two measurements are the same."""


@check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Observation:
    """A measured response and the excitation that caused it.

    The model of the measurement is polarity · gain · M(θ)(t − time_shift) + offset + drift · t + ε. A nuisance parameter
    without a prior has a fixed value (1, 0, 0, 0). The sensor may have its own sampling rate and start; M is then computed at
    the sensor's times, by polynomials through 6 samples of the record. Missing values do not enter the likelihood.

    Parameters
    ----------
    record : Excitation
        Excitation of the structure.
    values : array-like, shape (time,) or (time, channel)
        The measurement in SI; NaN for a missing value. Samples before and after the record are left out.
    channels : sequence of str
        Names of the measured channels.
    dt : float, optional
        Time step of the measurement [s]; by default that of the record.
    name : str
        Name of the observation.
    gain, offset, drift, time_shift : Marginal, optional
        Priors of the nuisance parameters: a pure number, the channel's unit, that unit per second, seconds. Each channel has
        its own gain, offset and drift.
    units : mapping of str to str, optional
        Display units of channels with non-standard names.
    sd : array-like, shape (time,) or (time, channel), or float, optional
        Known standard deviation of the error of every value in SI, such as an envelope. The error model then describes ε/sd.
        ``IID(variance=1.0)`` uses `sd` unchanged; any other variance is a pure number that multiplies sd².
    clock : float
        Time already subtracted from the instrument's times [s]; the values still contain the remainder of `time_shift`.
    start : float, optional
        Time of the first value on the record's time base [s]. By default 0; the measurement must then be as long as the record.
    polarity : str
        Direction of the sensor: ``"normal"``, ``"reversed"``, or ``"unknown"``. The likelihood is the mean over both directions
        if it is unknown.

    Attributes
    ----------
    left_out : tuple of int
        Number of samples before and after the record.

    Raises
    ------
    InputError
        If the measurement does not fit the record, a value is infinite, or a channel has fewer than ten values.

    Examples
    --------
    >>> import numpy as np
    >>> import structid as si
    >>> record = si.GroundMotion.synthetic(seed=7)
    >>> model = si.BoucWen(mass=12e3, stiffness=7.4e6, damping_ratio=0.03, alpha=0.05, beta=63.0, gamma=63.0)
    >>> velocity = model.simulate(np.empty((1, 0)), record).values[0]
    >>> measured = si.Observation(record, velocity, channels=("velocity",), offset=si.Normal(0.0, 1.0, unit="mm/s"))
    >>> measured.channels
    ('velocity',)

    A sensor with half the rate of the record, which fails after 12 s:

    >>> values = velocity[::2].copy()
    >>> values[int(12.0 / (2 * record.dt)) :] = np.nan
    >>> half = si.Observation(record, values, dt=2 * record.dt, polarity="unknown")
    >>> half.missing, half.dt == 2 * record.dt
    (1401, True)
    """

    record: Excitation
    values: np.ndarray
    channels: tuple[str, ...] = ("velocity",)
    dt: float | None = None
    name: str = ""
    gain: Marginal | None = None
    offset: Marginal | None = None
    time_shift: Marginal | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    sd: np.ndarray | float | None = None
    clock: float = 0.0
    start: float | None = None
    polarity: str = "normal"
    drift: Marginal | None = None
    left_out: tuple[int, int] = field(default=(0, 0), init=False)

    def __post_init__(self) -> None:
        where = f"observation '{self.name}'" if self.name else "observation"
        self._check_nuisances(where)
        if not isinstance(self.record, Excitation):
            raise InputError(
                f"{where}: record",
                f"{type(self.record).__name__}",
                "a GroundMotion, ForceHistory or DisplacementHistory",
            )
        channels = _checked_channels(self.channels, where)
        values = _checked_values(self.values, channels, where)
        dt = self.record.dt if self.dt is None or _same_step(self.dt, self.record.dt) else float(self.dt)
        if self.start is None:
            self._check_length(len(values), dt, where)
        start = 0.0 if self.start is None else float(self.start)
        inside = _inside(start, dt, len(values), self.record, where)
        for channel, unit in self.units.items():
            check_choice(f"{where}: units", channel, channels)
            declared_unit(channel, unit)
        sd = None if self.sd is None else _checked_sd(self.sd, values, where)[inside]
        values = values[inside].copy()
        for channel, known in zip(channels, np.isfinite(values).sum(axis=0), strict=True):
            if known < min(FEWEST_VALUES, len(self.record)):
                raise InputError(
                    f"{where}, channel '{channel}'",
                    f"{known} values within the record, which lasts {self.record.duration:.6g} s",
                    f"{FEWEST_VALUES} values or more",
                    "Check the start of the measurement and its missing values.",
                )
        left_out = inside.start, max(len(np.atleast_1d(self.values)) - inside.stop, 0)
        for array in (values, sd):
            if array is not None:
                array.setflags(write=False)
        settings = {"values": values, "channels": channels, "sd": sd, "dt": dt, "start": start + inside.start * dt}
        for name, value in (settings | {"left_out": left_out}).items():
            object.__setattr__(self, name, value)

    def _check_nuisances(self, where: str) -> None:
        """Refuse nuisance parameters that are not priors, and unknown polarities."""
        for name in NUISANCES:
            if not isinstance(prior := getattr(self, name), Marginal | None):
                raise InputError(
                    f"{where}: {name}",
                    "a number" if isinstance(prior, (int, float, np.number)) else f"{prior!r}",
                    f"a prior, such as {'Normal(1.0, 0.05)' if name == 'gain' else 'Normal(0.0, 0.01)'}",
                    KNOWN_NUISANCES[name],
                )
        check_choice(f"{where}: polarity", self.polarity, tuple(POLARITIES))
        if self.polarity == "unknown" and not isinstance(self.channels, str) and len(self.channels) > 1:
            raise InputError(
                f"{where}: polarity",
                f"an unknown polarity for {len(self.channels)} channels",
                "one channel",
                "Give each sensor its own Observation on the same record.",
            )

    def __str__(self) -> str:
        peaks = [
            f"{channel}, at most {peak / factor(unit.display):.4g} {unit.display}".rstrip()
            for channel, unit, peak in zip(
                self.channels, map(self.channel_unit, self.channels), self.peaks, strict=True
            )
        ]
        name = f" '{self.name}'" if self.name else ""
        samples = f"{len(self.values)} samples of {' and of '.join(peaks)}"
        sensor = f" ({self.sensor_in_words})" if self.sensor_in_words else ""
        return f"Observation{name}: {samples}{sensor}, under {self.record}"

    def __repr__(self) -> str:
        return f"<{self}>"

    @property
    def step(self) -> float:
        """Time step of the sensor [s]."""
        return self.record.dt if self.dt is None else self.dt

    @property
    def begin(self) -> float:
        """Time of the first value on the record's time base [s]."""
        return 0.0 if self.start is None else self.start

    @property
    def sensor_in_words(self) -> str:
        """Rate, start and polarity if they are not the usual ones, and what is missing or left out."""
        parts = []
        if self.sampling is not None:
            end = self.begin + self.step * (len(self.values) - 1)
            parts.append(f"every {self.step:g} s from {self.begin:.6g} to {end:.6g} s")
        if self.missing:
            parts.append(f"{self.missing:,} values missing")
        for count, side in zip(self.left_out, ("before", "after"), strict=True):
            if count:
                parts.append(f"{count:,} samples {side} the record left out")
        if self.polarity != "normal":
            parts.append(f"{self.polarity} polarity")
        return ", ".join(parts)

    def _check_length(self, samples: int, dt: float, where: str) -> None:
        """Refuse a measurement that is not as long as the record, if its start is not given."""
        record = self.record
        if _as_long(samples * dt, record, dt):
            return
        steps = f" (time steps: {dt:g} s and {record.dt:g} s)" if dt != record.dt else ""
        given = "" if self.dt is not None else " Give dt if the measurement has another time step."
        raise InputError(
            where,
            f"{samples} samples, but the record has {len(record)}{steps}",
            "a measurement as long as the record, or the time of its first value",
            f"Give start, the time of the first value on the record's time base in seconds, such as start=0.0.{given}",
        )

    @property
    def time(self) -> np.ndarray:
        """Times of the samples on the record's time base [s], shape (time,)."""
        if self.sampling is None:
            return self.record.time
        return np.asarray(self.begin + self.step * np.arange(len(self.values)))

    @cached_property
    def sampling(self) -> SensorSampling | None:
        """Samples as weighted sums of the record's samples; None if they are at the samples of the record."""
        times = self.begin + self.step * np.arange(len(self.values))
        return SensorSampling.of(times, self.record.dt, len(self.record))

    @cached_property
    def is_measured(self) -> np.ndarray:
        """Whether each value was measured, shape (time, channel)."""
        return np.asarray(np.isfinite(self.values))

    @property
    def missing(self) -> int:
        """Number of missing values."""
        return int((~self.is_measured).sum())

    @property
    def counts(self) -> np.ndarray | int:
        """Number of measured values: one number, or shape (channel, 1) if values are missing."""
        return self.is_measured.sum(axis=0)[:, None] if self.missing else len(self.values)

    @property
    def stretches(self) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """Begin and end [s] of the stretches with measured values, and of those before and after the record."""
        known = np.concatenate([[False], self.is_measured.any(axis=1), [False]])
        edges = np.flatnonzero(np.diff(known.astype(int)))
        time, half = self.time, 0.5 * self.step
        measured = [(time[a] - half, time[b - 1] + half) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        before, after = (count * self.step for count in self.left_out)
        outside = [(time[0] - half - before, time[0] - half), (time[-1] + half, time[-1] + half + after)]
        return measured, [(begin, end) for begin, end in outside if end > begin]

    @property
    def covered(self) -> np.ndarray:
        """Whether every channel was measured at or next to each sample of the record, shape (record time,)."""
        known = np.asarray(self.is_measured.all(axis=1))
        if self.sampling is None:
            return known
        index = np.searchsorted(self.time, self.record.time).clip(1, len(known) - 1)
        inside = (self.record.time >= self.time[0]) & (self.record.time <= self.time[-1])
        return np.asarray(inside & known[index] & known[index - 1])

    @property
    def peaks(self) -> np.ndarray:
        """Largest magnitude of each channel in SI, shape (channel,)."""
        return np.asarray(np.nanmax(np.abs(self.values), axis=0))

    @classmethod
    def read(
        cls,
        record: Excitation,
        path: str | os.PathLike[str],
        unit: str | None = None,
        channel: str = "velocity",
        column: int | str | None = None,
        dt: float | None = None,
        time_shift: Marginal | float | None = None,
        sd: float | None = None,
        sd_column: int | None = None,
        component: str | int | None = None,
        time_column: int | str | None = None,
        polarity: str = "normal",
        baseline: Sequence[float] | Sequence[tuple[float, float]] | None = None,
        missing: str = "refuse",
        gaps: Sequence[tuple[float, float]] = (),
        **nuisances: Marginal,
    ) -> Observation:
        """Read a measured history from a file of a logger, a laboratory, a program or a strong-motion network.

        Parameters
        ----------
        record : Excitation
            Excitation of the structure.
        path : path-like
            The file; `GroundMotion.read` reads the same formats.
        unit : str, optional
            Unit of the values. It must agree with a unit in the file.
        channel : str
            Name of the measured channel.
        column : int or str, optional
            Column of the values in a table: its number, counted from 0, or its title.
        dt : float, optional
            Time step [s] of a file without a time column.
        time_shift : Marginal or float, optional
            Time in the file at which the record begins [s], or its prior. The time base is shifted by this time, or by the prior's
            median. Without it, the file must begin at 0 s and be as long as the record.
        sd : float, optional
            Known standard deviation of the errors in SI.
        sd_column : int, optional
            Column of known standard deviations, in the unit of the values.
        component : str or int, optional
            Channel of a file with several channels: its name or its number from 1.
        time_column : int or str, optional
            Column of the times in a table; by default the one whose title names the time, or the first.
        polarity : str
            ``"normal"``, ``"reversed"`` or ``"unknown"``.
        baseline : pair of float, or two pairs, optional
            Two times in the file [s] between which the structure is at rest. The mean between them, the sensor's offset, is
            subtracted. For two such stretches, the line through both means is subtracted, an offset with a drift.
        missing : str
            Empty cells, NaN and missing lines of a table: ``"refuse"`` them, or ``"leave_out"`` of the likelihood.
        gaps : sequence of pair of float, optional
            Begin and end of stretches [s], by the times in the file, that the likelihood leaves out.
        **nuisances : Marginal
            Priors of gain, offset and drift.

        Returns
        -------
        Observation
            The measurement.
        """
        if unknown := set(nuisances) - {"gain", "offset", "drift"}:
            name = min(unknown)
            arguments = (
                "channel",
                "column",
                "dt",
                "time_shift",
                "sd",
                "sd_column",
                "component",
                "time_column",
                "polarity",
                "baseline",
                "missing",
                "gaps",
                "gain",
                "offset",
                "drift",
            )
            raise InputError(
                "Observation.read", f"the argument '{name}'", ", ".join(arguments), suggestion(name, arguments)
            )
        others = () if sd_column is None else (sd_column,)
        si = standard_unit(channel).si or None
        if unit is None and si is None:
            raise InputError(
                f"{path}",
                f"no unit for the channel '{channel}', which has no standard unit",
                "a unit",
                "Give it: unit='kN'.",
            )
        if isinstance(time_shift, bool):
            raise InputError(f"{path}: time_shift", f"{time_shift}", "a time in seconds, or its prior")
        leave_out = check_choice(f"{path}: missing", missing, ("refuse", "leave_out")) == "leave_out"
        start, step, values = read_signal(path, unit, dt, column, si, others, time_column, component, leave_out)
        time = start + step * np.arange(len(values))
        values = _without(gaps, time, values, f"{path}: gaps")
        if baseline is not None:
            values = np.concatenate(
                [
                    remove_offset(values[:, :1], time, stretches(baseline, f"{path}: baseline"), f"{path}: baseline"),
                    values[:, 1:],
                ],
                axis=1,
            )
        if abs(start) < AT_ZERO * step:
            start = 0.0
        prior = time_shift if isinstance(time_shift, Marginal) else None
        known_shift = time_shift if isinstance(time_shift, (int, float)) else None
        if prior is not None and not (abs(start) <= 0.5 * step and len(values) == len(record)):
            known_shift = float(prior.quantile(np.array([0.5]))[0])  # the remaining shift is inferred
        if known_shift is None and abs(start) > 0.5 * step:
            raise InputError(
                f"{path}",
                f"the first time is {start:g} s",
                "times that start at 0 s, as in the record",
                f"If the record begins at {start:g} s in this file, set time_shift = {start:g} (in a study file "
                f'"{start:g} s"). If file and record have the same time base, set time_shift = 0.',
            )
        if known_shift is None and prior is None and not _as_long(len(values) * step, record, step):
            raise InputError(
                f"{path}",
                f"the history lasts {len(values) * step:.6g} s, the record {len(record) * record.dt:.6g} s",
                "a history as long as the record, or the time in the file at which the record begins",
                "Set time_shift to this time, or to 0 if both begin together; structid leaves out what is before and after.",
            )
        units = {} if si else {channel: str(unit)}
        clock = 0.0 if prior is None or known_shift is None else known_shift
        nuisances |= {} if prior is None else {"time_shift": prior}
        return cls(
            record,
            values[:, 0],
            (channel,),
            step,
            str(path),
            units=units,
            sd=values[:, 1] if others else sd,
            clock=clock,
            start=start - (known_shift or 0.0),
            polarity=polarity,
            **nuisances,
        )

    def channel_unit(self, channel: str) -> ChannelUnit:
        """Units of a channel, declared or defined by its standard name.

        Parameters
        ----------
        channel : str
            A measured channel.

        Returns
        -------
        ChannelUnit
            SI unit and display unit.
        """
        return declared_unit(channel, self.units[channel]) if channel in self.units else standard_unit(channel)

    @property
    def si_units(self) -> tuple[str, ...]:
        """SI unit of each channel; empty for an unknown dimension."""
        return tuple(self.channel_unit(channel).si for channel in self.channels)

    def check_new(self, others: Sequence[Observation]) -> None:
        """Refuse this observation if it duplicates another one.

        Parameters
        ----------
        others : sequence of Observation
            The other observations.

        Raises
        ------
        InputError
            If another observation has the same values to three digits, for the same channels and record.
        """
        for number, other in enumerate(others, start=1):
            if self._repeats(other):
                raise InputError(
                    f"observation {len(others) + 1}",
                    f"it repeats the measurement of observation {number}",
                    "each measurement once",
                    "Remove the copy, since repeated data would count twice.",
                )

    def _repeats(self, other: Observation) -> bool:
        """Whether another observation has the same values at the times that both have."""
        if self.channels != other.channels or self.record.content_hash != other.record.content_hash:
            return False
        later = (other.begin - self.begin) / self.step
        shift = round(later)
        if not _same_step(self.step, other.step) or abs(later - shift) > AT_ZERO:
            return False
        mine, others = self.values[max(shift, 0) :], other.values[max(-shift, 0) :]
        count = min(len(mine), len(others))
        differences = np.abs(mine[:count] - others[:count])
        common = np.isfinite(differences)
        enough = common.sum() >= COMMON_SHARE * min(self.is_measured.sum(), other.is_measured.sum())
        # A second copy may be rounded. Two tests on one record differ by more than rounding.
        return bool(enough and differences[common].max(initial=0.0) <= ROUNDED * self.peaks.max())

    @property
    def weights(self) -> np.ndarray | None:
        """1/sd of every value, and 0 for a missing value, shape (time, channel); None if all are 1."""
        if self.sd is None:
            return self.is_measured.astype(np.float64) if self.missing else None
        return np.where(self.is_measured, 1.0 / np.asarray(self.sd), 0.0)

    def weighted(self, values: Any) -> Any:
        """Divide values, residuals or sensitivities by the known standard deviations, and set them to 0 where a value is missing.

        Parameters
        ----------
        values : array, shape (time, channel) or (time, channel, run)
            Values in SI.

        Returns
        -------
        array
            Quotients, in the shape of `values`.
        """
        more = (1,) * (values.ndim - 2)
        if self.missing:
            values = namespace(values).where(self.is_measured.reshape(*self.is_measured.shape, *more), values, 0.0)
        if self.sd is None:
            return values
        sd = np.asarray(self.sd)
        return values / sd.reshape(sd.shape + more)

    @property
    def log_sds(self) -> np.ndarray:
        """Logarithms of the known standard deviations, shape (time, channel); 0 if there are none or a value is missing."""
        return np.zeros(self.values.shape) if self.sd is None else np.where(self.is_measured, np.log(self.sd), 0.0)

    @property
    def error_units(self) -> tuple[str, ...]:
        """SI unit of the errors of each channel; empty if the errors are relative to known standard deviations."""
        return self.si_units if self.sd is None else ("",) * len(self.channels)

    def nuisances(self) -> dict[str, Marginal]:
        """Unknown nuisance parameters and their priors.

        Returns
        -------
        dict of str to Marginal
            ``gain``, ``offset`` and ``drift`` for each channel, and one ``time_shift``.
        """
        priors: dict[str, Marginal] = {}
        for kind in ("gain", "offset", "drift"):
            prior = getattr(self, kind)
            if prior is not None:
                priors.update({parameter_name(kind, c, self.channels): prior for c in self.channels})
        if self.time_shift is not None:
            priors["time_shift"] = self.time_shift
        return priors

    def transmit(self, response: Any, unknown: Mapping[str, Any], sign: Any = None) -> Any:
        """Convert a model response to the predicted reading of the instrument, inside JAX or of NumPy arrays.

        Parameters
        ----------
        response : array, shape (time, channel, run)
            The model's response at the samples of the record.
        unknown : mapping of str to array, shape (run,)
            Nuisance parameters.
        sign : float or array, shape (run,), optional
            Sign of an unknown polarity; by default 1.

        Returns
        -------
        array, shape (time, channel, run)
            polarity · gain · M(t − time_shift) + offset + drift · t, at the samples of the sensor.
        """
        return self.instrument.transmitted(response, unknown, sign)

    @cached_property
    def instrument(self) -> Instrument:
        """What the sensor shows of a response."""
        nuisances = frozenset(name for name in NUISANCES if getattr(self, name) is not None)
        return Instrument(
            self.channels, self.record.time, self.time, self.sampling, self.polarity, nuisances, self.clock
        )

    def describe(self) -> dict[str, Any]:
        """Return all data on which a posterior depends, for hashes.

        Returns
        -------
        dict
            Hashes of record and values, channels and nuisance parameters.
        """
        return {
            "record": self.record.content_hash,
            "values": digest(self.values),
            "channels": list(self.channels),
            "nuisances": {k: v.describe() for k, v in self.nuisances().items()},
            **({} if self.sd is None else {"sd": digest(self.sd)}),
            **({"clock": self.clock} if self.clock else {}),
            **({} if self.sampling is None else {"dt": self.step, "start": self.begin}),
            **({} if self.polarity == "normal" else {"polarity": self.polarity}),
        }


def _checked_channels(given: Any, where: str) -> tuple[str, ...]:
    """Return the names of the channels, after a check."""
    channels = (given,) if isinstance(given, str) else tuple(given)
    if not channels:
        raise InputError(f"{where}: channels", "no channels", "one or more channels, such as 'velocity'")
    for channel in channels:
        check_name(f"{where}: channels", channel)
    if len(set(channels)) < len(channels):
        raise InputError(
            f"{where}: channels",
            f"{', '.join(channels)}",
            "each channel once",
            "For two instruments on one channel, give two observations on the same record.",
        )
    return channels


def _without(gaps: Sequence[tuple[float, float]], time: np.ndarray, values: np.ndarray, where: str) -> np.ndarray:
    """Return values with NaN in some stretches of time."""
    values = values.copy()
    if not isinstance(gaps, Sequence) or isinstance(gaps, str):
        raise InputError(where, f"{gaps!r}", "a list of pairs of times in seconds, such as [(9.1, 9.8)]")
    for begin, end in (pair_of_times(gap, where) for gap in gaps):
        inside = between(time, begin, end)
        if not inside.any():
            raise InputError(
                where,
                f"no sample between {begin:g} and {end:g} s",
                f"stretches between {time[0]:.6g} and {time[-1]:.6g} s, the begin before the end",
            )
        values[inside, 0] = np.nan
    return values


def _checked_values(given: Any, channels: tuple[str, ...], where: str) -> np.ndarray:
    """Return the values, shape (time, channel), after a check."""
    values = np.array(given, dtype=np.float64)
    values = values[:, None] if values.ndim == 1 else values
    if values.ndim != 2 or values.shape[1] != len(channels):
        raise InputError(
            where,
            f"an array of shape {np.shape(given)}",
            f"(time, {len(channels)}) for the channels {', '.join(channels)}",
        )
    if not len(values):
        raise InputError(where, "no values", "a measured history")
    if np.isinf(values).any():
        raise InputError(
            where,
            f"{np.count_nonzero(np.isinf(values))} infinite values",
            "finite numbers, or NaN for a missing value",
        )
    values[np.isnan(values)] = np.nan  # one bit pattern, for the hash
    return values


def _same_step(one: float, other: float) -> bool:
    """Whether two time steps are equal."""
    return abs(one / other - 1.0) <= SAME_STEP


def _as_long(duration: float, record: Excitation, dt: float) -> bool:
    """Whether a history is as long as the record, to one sample if the time steps differ."""
    tolerance = 0.5 * dt if _same_step(dt, record.dt) else max(dt, record.dt) * (1.0 + SAME_STEP)
    return abs(duration - len(record) * record.dt) <= tolerance


def _inside(start: float, dt: float, samples: int, record: Excitation, where: str) -> slice:
    """Return the samples within the record."""
    if not (np.isfinite(start) and 0.0 < dt < np.inf):
        raise InputError(where, f"start {start} s and time step {dt} s", "finite times and a positive step")
    end = record.dt * (len(record) - 1)
    first = max(int(np.ceil(-start / dt - 1e-6)), 0)
    last = min(int(np.floor((end - start) / dt + 1e-6)), samples - 1)
    if last < first:
        raise InputError(
            where,
            f"a measurement from {start:.6g} to {start + dt * (samples - 1):.6g} s on the record's time base",
            f"times within the record, from 0 to {end:.6g} s",
            "Check the sign: time_shift is the time in the measurement's file at which the record begins.",
        )
    return slice(first, last + 1)


def _checked_sd(given: Any, values: np.ndarray, where: str) -> np.ndarray:
    """Return the known standard deviations, one per value, after a check."""
    sd = np.array(given, dtype=np.float64)
    sd = sd[:, None] if sd.ndim == 1 else sd
    try:
        whole = np.array(np.broadcast_to(sd, values.shape))
    except ValueError:
        raise InputError(
            f"{where}: sd", f"an array of shape {np.shape(given)}", f"one number, or an array of shape {values.shape}"
        ) from None
    # A missing value needs none; figures use a usual one.
    for column, missing in zip(whole.T, np.isnan(values).T, strict=True):
        column[missing] = np.median(column[~missing]) if not missing.all() else 1.0
    if not (np.isfinite(whole).all() and (whole > 0.0).all()):
        wrong = np.count_nonzero(~(np.isfinite(whole) & (whole > 0.0)))
        raise InputError(
            f"{where}: sd",
            f"{wrong} of {whole.size} values are not positive and finite",
            "positive standard deviations",
            "To give a measured value little weight, use a large standard deviation.",
        )
    return whole
