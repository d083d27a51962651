"""Measured responses: excitation, values, and nuisance parameters of the instrument."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from structid.core.channels import ChannelUnit, declared_unit, standard_unit
from structid.core.errors import InputError, check_choice, suggestion
from structid.core.hashing import digest
from structid.core.units import factor
from structid.core.validation import check_arguments, check_name
from structid.data_files.read_file import read_signal
from structid.engine.device import jnp
from structid.ground_motion.excitation import Excitation
from structid.probability.truncation import Marginal

NUISANCES = ("gain", "offset", "time_shift")
"""Nuisance parameters of an instrument."""
KNOWN_NUISANCES = {
    "gain": "Divide the values by a known gain; use -values if a sensor points in the opposite direction.",
    "offset": "Subtract a known offset from the values.",
    "time_shift": "Give a known shift to Observation.read, which shifts the values in time.",
}
"""Remedy if a nuisance parameter is known."""


SAME_STEP = 1e-6
"""Relative difference below which two time steps are equal."""

ROUNDED = 5e-4
"""Difference relative to the peak below which two measurements are the same."""


@check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Observation:
    """A measured response and the excitation that caused it.

    The model of the measurement is gain · M(θ)(t − time_shift) + offset + ε. A nuisance parameter without a prior has a fixed
    value (1, 0, 0).

    Parameters
    ----------
    record : Excitation
        Excitation of the structure.
    values : array-like, shape (time,) or (time, channel)
        The measurement in SI, at the samples of the record.
    channels : sequence of str
        Names of the measured channels.
    dt : float, optional
        Time step of the measurement [s]; it must equal the time step of the record.
    name : str
        Name of the observation.
    gain, offset, time_shift : Marginal, optional
        Priors of the nuisance parameters: a pure number, the channel's unit, seconds. Each channel has its own gain and offset.
    units : mapping of str to str, optional
        Display units of channels with non-standard names.
    sd : array-like, shape (time,) or (time, channel), or float, optional
        Known standard deviation of the error of every value in SI, such as an envelope. The error model then describes ε/sd.
        ``IID(variance=1.0)`` uses `sd` unchanged; any other variance is a pure number that multiplies sd².
    clock : float
        Time already subtracted from the instrument's times [s]; the values still contain the remainder of `time_shift`.

    Raises
    ------
    InputError
        If the length or time step differs from the record, or a value is not finite.

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

    def __post_init__(self) -> None:
        where = f"observation '{self.name}'" if self.name else "observation"
        for name in NUISANCES:
            if not isinstance(prior := getattr(self, name), Marginal | None):
                raise InputError(
                    f"{where}: {name}",
                    "a number" if isinstance(prior, (int, float, np.number)) else f"{prior!r}",
                    f"a prior, such as {'Normal(1.0, 0.05)' if name == 'gain' else 'Normal(0.0, 0.01)'}",
                    KNOWN_NUISANCES[name],
                )
        if not isinstance(self.record, Excitation):
            raise InputError(
                f"{where}: record",
                f"{type(self.record).__name__}",
                "a GroundMotion, ForceHistory or DisplacementHistory",
            )
        channels = (self.channels,) if isinstance(self.channels, str) else tuple(self.channels)
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
        values = np.array(self.values, dtype=np.float64)
        values = values[:, None] if values.ndim == 1 else values
        if values.ndim != 2 or values.shape[1] != len(channels):
            raise InputError(
                where,
                f"an array of shape {np.shape(self.values)}",
                f"(time, {len(channels)}) for the channels {', '.join(channels)}",
            )
        if len(values) != len(self.record):
            raise InputError(
                where,
                f"{len(values)} samples, but the record has {len(self.record)}",
                "as many samples as the record",
                self._cure(len(values)),
            )
        if self.dt is not None and abs(self.dt / self.record.dt - 1.0) > SAME_STEP:
            raise InputError(
                where,
                f"a time step of {self.dt:g} s, but the record has {self.record.dt:g} s",
                "the time step of the record",
                "Resample the record or the measurement.",
            )
        if not np.isfinite(values).all():
            raise InputError(
                where,
                f"{np.count_nonzero(~np.isfinite(values))} values that are not finite",
                "finite numbers",
            )
        for channel, unit in self.units.items():
            check_choice(f"{where}: units", channel, channels)
            declared_unit(channel, unit)
        values.setflags(write=False)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "channels", channels)
        if self.sd is not None:
            object.__setattr__(self, "sd", _checked_sd(self.sd, values.shape, where))

    def __str__(self) -> str:
        peaks = [
            f"{channel}, at most {peak / factor(unit.display):.4g} {unit.display}".rstrip()
            for channel, unit, peak in zip(
                self.channels, map(self.channel_unit, self.channels), np.abs(self.values).max(axis=0), strict=True
            )
        ]
        name = f" '{self.name}'" if self.name else ""
        return f"Observation{name}: {len(self.values)} samples of {' and of '.join(peaks)}, under {self.record}"

    def __repr__(self) -> str:
        return f"<{self}>"

    def _cure(self, samples: int) -> str:
        """Advice if measurement and record differ in length."""
        record = self.record
        if self.dt is not None and abs(self.dt / record.dt - 1.0) > SAME_STEP:
            return (
                f"The measurement has a time step of {self.dt:g} s, the record {record.dt:g} s. Resample the record: "
                f'resample = "{self.dt:g} s" in [record], or record.resample({self.dt:g}).'
            )
        longer = (samples - len(record)) * record.dt
        if longer > 0.0:
            return (
                f"The measurement is {longer:.6g} s longer than the record. If it starts before the record, give the difference as "
                "time_shift; structid then cuts the surplus at the end."
            )
        return f"The measurement is {-longer:.6g} s shorter than the record. Trim the record to the same end."

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
            Time in the file at which the record begins [s], or its prior. The history is shifted by this time, or by the prior's
            median, and cut to the record. Cubic splines interpolate between samples.
        sd : float, optional
            Known standard deviation of the errors in SI.
        sd_column : int, optional
            Column of known standard deviations, in the unit of the values.
        component : str or int, optional
            Channel of a file with several channels: its name or its number from 1.
        time_column : int or str, optional
            Column of the times in a table; by default the one whose title names the time, or the first.
        **nuisances : Marginal
            Priors of gain and offset.

        Returns
        -------
        Observation
            The measurement.
        """
        if unknown := set(nuisances) - {"gain", "offset"}:
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
                "gain",
                "offset",
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
        start, step, values = read_signal(path, unit, dt, column, si, others, time_column, component)
        prior = time_shift if isinstance(time_shift, Marginal) else None
        known_shift = time_shift if isinstance(time_shift, (int, float)) else None
        if prior is not None and not (abs(start) <= 0.5 * step and len(values) == len(record)):
            known_shift = float(prior.quantile(np.array([0.5]))[0])  # the remaining shift is inferred
        if known_shift is not None:
            values = _on_the_clock_of(record, start - known_shift, step, values, str(path))
        elif abs(start) > 0.5 * step:
            raise InputError(
                f"{path}",
                f"the first time is {start:g} s",
                "times that start at 0 s, as in the record",
                f"If the record begins at {start:g} s in this file, set time_shift = {start:g} (in a study file "
                f'"{start:g} s").',
            )
        units = {} if si else {channel: str(unit)}
        known_sds = values[:, 1] if others else sd
        clock = 0.0 if prior is None or known_shift is None else known_shift
        nuisances |= {} if prior is None else {"time_shift": prior}
        return cls(
            record, values[:, 0], (channel,), step, str(path), units=units, sd=known_sds, clock=clock, **nuisances
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
            same = self.channels == other.channels and self.record.content_hash == other.record.content_hash
            # A second copy may be rounded. Two tests on one record differ by more than rounding.
            if same and np.abs(self.values - other.values).max() <= ROUNDED * np.abs(self.values).max():
                raise InputError(
                    f"observation {len(others) + 1}",
                    f"it repeats the measurement of observation {number}",
                    "each measurement once",
                    "Remove the copy, since repeated data would count twice.",
                )

    def in_sds(self, values: Any) -> Any:
        """Divide values, residuals or sensitivities by the known standard deviations, if there are any.

        Parameters
        ----------
        values : array, shape (time, channel) or (time, channel, run)
            Values in SI.

        Returns
        -------
        array
            Quotients, in the shape of `values`.
        """
        if self.sd is None:
            return values
        sd = np.asarray(self.sd)
        return values / sd.reshape(sd.shape + (1,) * (values.ndim - 2))

    @property
    def log_sds(self) -> np.ndarray:
        """Logarithms of the known standard deviations, shape (time, channel); zeros if there are none."""
        return np.zeros(self.values.shape) if self.sd is None else np.log(self.sd)

    @property
    def error_units(self) -> tuple[str, ...]:
        """SI unit of the errors of each channel; empty if the errors are relative to known standard deviations."""
        return self.si_units if self.sd is None else ("",) * len(self.channels)

    def nuisances(self) -> dict[str, Marginal]:
        """Unknown nuisance parameters and their priors.

        Returns
        -------
        dict of str to Marginal
            ``gain`` and ``offset`` for each channel, and one ``time_shift``.
        """
        priors: dict[str, Marginal] = {}
        for kind in ("gain", "offset"):
            prior = getattr(self, kind)
            if prior is not None:
                priors.update({self._name(kind, c): prior for c in self.channels})
        if self.time_shift is not None:
            priors["time_shift"] = self.time_shift
        return priors

    def _name(self, kind: str, channel: str) -> str:
        return kind if len(self.channels) == 1 else f"{kind}_{channel}"

    def transmit(self, response: Any, unknown: Mapping[str, Any]) -> Any:
        """Convert a model response to the predicted reading of the instrument, inside JAX.

        Parameters
        ----------
        response : jax.Array, shape (time, channel, run)
            The model's response.
        unknown : mapping of str to jax.Array (run,)
            Nuisance parameters.

        Returns
        -------
        jax.Array, shape (time, channel, run)
            gain · M(t − time_shift) + offset.
        """
        if self.time_shift is not None:
            response = _shifted(response, (unknown["time_shift"] - self.clock) / self.record.dt)
        if self.gain is not None:
            response = response * jnp.stack([unknown[self._name("gain", c)] for c in self.channels])
        if self.offset is not None:
            response = response + jnp.stack([unknown[self._name("offset", c)] for c in self.channels])
        return response

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
        }


def _on_the_clock_of(record: Excitation, start: float, dt: float, values: np.ndarray, where: str) -> np.ndarray:
    """Interpolate columns to the samples of the record, given the time of the first line."""
    if abs(dt / record.dt - 1.0) > SAME_STEP:
        return values  # the constructor of the observation refuses them with a reason
    first, last, last_sample = start, start + dt * (len(values) - 1), record.dt * (len(record) - 1)
    if first > 1e-3 * dt or last < last_sample - 1e-3 * dt:
        raise InputError(
            where,
            f"after time_shift the history covers {first:.6g} to {last:.6g} s of the record",
            f"a history that covers the whole record, from 0 to {last_sample:.6g} s",
            "Check the sign: time_shift is the time in the history's file at which the record begins. Or trim the record.",
        )
    behind = -start / dt
    if abs(behind - round(behind)) < 1e-3:
        return values[round(behind) : round(behind) + len(record)]
    spline = scipy.interpolate.CubicSpline(start + dt * np.arange(len(values)), values)
    return np.asarray(spline(record.time))


def _checked_sd(given: Any, shape: tuple[int, ...], where: str) -> np.ndarray:
    """Return the known standard deviations, one per value, after a check."""
    sd = np.array(given, dtype=np.float64)
    sd = sd[:, None] if sd.ndim == 1 else sd
    try:
        whole = np.array(np.broadcast_to(sd, shape))
    except ValueError:
        raise InputError(
            f"{where}: sd", f"an array of shape {np.shape(given)}", f"one number, or an array of shape {shape}"
        ) from None
    if not (np.isfinite(whole).all() and (whole > 0.0).all()):
        wrong = np.count_nonzero(~(np.isfinite(whole) & (whole > 0.0)))
        raise InputError(
            f"{where}: sd",
            f"{wrong} of {whole.size} values are not positive and finite",
            "positive standard deviations",
            "To give a measured value little weight, use a large standard deviation.",
        )
    whole.setflags(write=False)
    return whole


def _shifted(response: Any, samples: Any) -> Any:
    """Return M(t − τ) by cubic (Catmull-Rom) interpolation; it is constant beyond the ends."""
    last = response.shape[0] - 1
    position = jnp.arange(response.shape[0])[:, None] - samples[None, :]
    base = jnp.floor(position)
    f = (position - base)[:, None, :]

    def at(offset: int) -> Any:
        rows = jnp.clip(base.astype(int) + offset, 0, last)
        return jnp.take_along_axis(response, rows[:, None, :], axis=0)

    p0, p1, p2, p3 = at(-1), at(0), at(1), at(2)
    return p1 + 0.5 * f * (p2 - p0 + f * (2 * p0 - 5 * p1 + 4 * p2 - p3 + f * (3 * (p1 - p2) + p3 - p0)))
