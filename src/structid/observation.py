"""Measured responses: the excitation, the values, the instrument's nuisance parameters."""

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
from structid.engine.device import jnp
from structid.ground_motion.excitation import Excitation
from structid.ground_motion.readers import read_columns
from structid.probability.truncation import Marginal

NUISANCES = ("gain", "offset", "time_shift")
"""Nuisance parameters of an instrument."""
KNOWN_NUISANCES = {
    "gain": "A known gain is divided out of the values: -values, where a sensor points the other way.",
    "offset": "A known offset is subtracted from the values.",
    "time_shift": "A known shift is given to Observation.read, which moves the values.",
}
"""What to do where a nuisance parameter is known."""


SAME_STEP = 1e-6
"""Relative difference below which two time steps are equal."""

ROUNDED = 5e-4
"""Difference relative to the peak below which two measurements are the same."""


@check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Observation:
    """A measured response: what drove the structure, and what was recorded.

    The measurement is taken to be gain · M(θ)(t − time_shift) + offset + ε. Each nuisance is left out (1, 0, 0) unless it is given
    a prior.

    Parameters
    ----------
    record : Excitation
        What drove it.
    values : array-like, shape (time,) or (time, channel)
        The measurement in SI, at the record's samples.
    channels : sequence of str
        What was measured.
    dt : float, optional
        Its time step [s], to be checked against the record's.
    name : str
        Name of the observation.
    gain, offset, time_shift : Marginal, optional
        Priors of the nuisances: a pure number, the channel's unit, seconds. Gain and offset are one for each channel.
    units : mapping of str to str, optional
        Units in which tables and figures show channels whose names are not standard ones.
    sd : array-like, shape (time,) or (time, channel), or float, optional
        Known standard deviation of every value's error in SI, such as an envelope. The error model is then that of ε/sd: with
        ``IID(variance=1.0)`` they are taken as they are, and otherwise its variance, a pure number, multiplies their squares.
    clock : float
        What has been taken off the instrument's clock already [s]; the rest of `time_shift` is still in the values.

    Raises
    ------
    InputError
        If length or step differ from the record's, or a value is not finite.

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
            raise InputError(f"{where}: channels", "none", "one or more, such as 'velocity'")
        for channel in channels:
            check_name(f"{where}: channels", channel)
        if len(set(channels)) < len(channels):
            raise InputError(
                f"{where}: channels",
                f"{', '.join(channels)}",
                "each channel once",
                "Two instruments that measured the same are two observations on one record.",
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
                f"{len(values)} samples, and the record has {len(self.record)}",
                "as many samples as the record",
                self._cure(len(values)),
            )
        if self.dt is not None and abs(self.dt / self.record.dt - 1.0) > SAME_STEP:
            raise InputError(
                where,
                f"a time step of {self.dt:g} s, and the record has {self.record.dt:g} s",
                "the record's time step",
                "Resample the one to the other.",
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
        """Advice where measurement and record differ in length."""
        record = self.record
        if self.dt is not None and abs(self.dt / record.dt - 1.0) > SAME_STEP:
            return (
                f"It was measured every {self.dt:g} s, and the record has a value every {record.dt:g} s: bring the record to its "
                f'step by resample = "{self.dt:g} s" in [record], or record.resample({self.dt:g}).'
            )
        longer = (samples - len(record)) * record.dt
        if longer > 0.0:
            return (
                f"It is {longer:.6g} s longer than the record. If its clock began before the record does, say by how much: "
                "time_shift; what is left over at its end is cut."
            )
        return f"It is {-longer:.6g} s shorter than the record. End the record with it: trim."

    @classmethod
    def read(
        cls,
        record: Excitation,
        path: str | os.PathLike[str],
        unit: str,
        channel: str = "velocity",
        column: int | None = None,
        dt: float | None = None,
        time_shift: Marginal | float | None = None,
        sd: float | None = None,
        sd_column: int | None = None,
        **nuisances: Marginal,
    ) -> Observation:
        """Read a measured history from text columns.

        Parameters
        ----------
        record : Excitation
            What drove the structure.
        path : path-like
            Text or CSV with a time and a value column, or values alone with `dt`.
        unit : str
            Unit of the values.
        channel : str
            What was measured.
        column : int, optional
            Column of the values, counted from 0.
        dt : float, optional
            Time step [s] of a file without times.
        time_shift : Marginal or float, optional
            When the record begins by the clock of the file [s], or its prior. The history is moved by it, or by the prior's median,
            and cut to the record; between samples it is interpolated by cubic splines.
        sd : float, optional
            Known standard deviation of the errors in SI.
        sd_column : int, optional
            Column of known standard deviations, in the unit of the values.
        **nuisances : Marginal
            Priors of gain and offset.

        Returns
        -------
        Observation
            The measurement.
        """
        if unknown := set(nuisances) - {"gain", "offset"}:
            name = min(unknown)
            arguments = ("channel", "column", "dt", "time_shift", "sd", "sd_column", "gain", "offset")
            raise InputError(
                "Observation.read", f"the argument '{name}'", ", ".join(arguments), suggestion(name, arguments)
            )
        others = () if sd_column is None else (sd_column,)
        start, step, values = read_columns(path, unit, dt, column, standard_unit(channel).si or None, others)
        prior = time_shift if isinstance(time_shift, Marginal) else None
        known_shift = time_shift if isinstance(time_shift, (int, float)) else None
        if prior is not None and not (abs(start) <= 0.5 * step and len(values) == len(record)):
            known_shift = float(prior.quantile(np.array([0.5]))[0])  # the rest is inferred
        if known_shift is not None:
            values = _on_the_clock_of(record, start - known_shift, step, values, str(path))
        elif abs(start) > 0.5 * step:
            raise InputError(
                f"{path}",
                f"the first time is {start:g} s",
                "times that start at 0 s, like the record",
                f"If the record begins when this clock shows {start:g} s, say time_shift = {start:g} (in a study file "
                f'"{start:g} s").',
            )
        units = {} if standard_unit(channel).si else {channel: unit}
        known_sds = values[:, 1] if others else sd
        clock = 0.0 if prior is None or known_shift is None else known_shift
        nuisances |= {} if prior is None else {"time_shift": prior}
        return cls(
            record, values[:, 0], (channel,), step, str(path), units=units, sd=known_sds, clock=clock, **nuisances
        )

    def channel_unit(self, channel: str) -> ChannelUnit:
        """Units of a channel: as declared, or as its standard name defines them.

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
        """SI unit of each channel; empty where the dimension is unknown."""
        return tuple(self.channel_unit(channel).si for channel in self.channels)

    def check_new(self, others: Sequence[Observation]) -> None:
        """Refuse to be one of the other observations once more.

        Parameters
        ----------
        others : sequence of Observation
            The other ones.

        Raises
        ------
        InputError
            If one has the same values, to three digits, of the same channels on the same record.
        """
        for number, other in enumerate(others, start=1):
            same = self.channels == other.channels and self.record.content_hash == other.record.content_hash
            # Rounded when it was written once more. Two tests on one record differ by more.
            if same and np.abs(self.values - other.values).max() <= ROUNDED * np.abs(self.values).max():
                raise InputError(
                    f"observation {len(others) + 1}",
                    f"the same measurement as number {number}",
                    "each measurement once",
                    "Twice the same data would count as twice as many.",
                )

    def in_sds(self, values: Any) -> Any:
        """Divide values, residuals or sensitivities by the known standard deviations; the same where there are none.

        Parameters
        ----------
        values : array, shape (time, channel) or (time, channel, run)
            In SI.

        Returns
        -------
        array
            In the same shape.
        """
        if self.sd is None:
            return values
        sd = np.asarray(self.sd)
        return values / sd.reshape(sd.shape + (1,) * (values.ndim - 2))

    @property
    def log_sds(self) -> np.ndarray:
        """Logarithms of the known standard deviations, shape (time, channel); zeros where there are none."""
        return np.zeros(self.values.shape) if self.sd is None else np.log(self.sd)

    @property
    def error_units(self) -> tuple[str, ...]:
        """SI unit of the errors, for each channel; none where they are relative to known standard deviations."""
        return self.si_units if self.sd is None else ("",) * len(self.channels)

    def nuisances(self) -> dict[str, Marginal]:
        """Unknown nuisances and their priors.

        Returns
        -------
        dict of str to Marginal
            ``gain`` and ``offset`` once a channel, ``time_shift`` once.
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
        """Turn a model's response into what the instrument would show, inside JAX.

        Parameters
        ----------
        response : jax.Array, shape (time, channel, run)
            The model's response.
        unknown : mapping of str to jax.Array (run,)
            The nuisances.

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
        """Return everything a posterior depends on, for hashes.

        Returns
        -------
        dict
            Hashes of record and values, channels and nuisances.
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
    """Interpolate columns to the record's samples, given the time of their first line."""
    if abs(dt / record.dt - 1.0) > SAME_STEP:
        return values  # refused with its reason where the observation is made
    first, last, last_sample = start, start + dt * (len(values) - 1), record.dt * (len(record) - 1)
    if first > 1e-3 * dt or last < last_sample - 1e-3 * dt:
        raise InputError(
            where,
            f"a history from {first:.6g} to {last:.6g} s of the record's time, after time_shift",
            f"one that covers the record, from 0 to {last_sample:.6g} s",
            "Check the sign: time_shift is what the history's clock shows when the record begins. Or trim the record.",
        )
    behind = -start / dt
    if abs(behind - round(behind)) < 1e-3:
        return values[round(behind) : round(behind) + len(record)]
    spline = scipy.interpolate.CubicSpline(start + dt * np.arange(len(values)), values)
    return np.asarray(spline(record.time))


def _checked_sd(given: Any, shape: tuple[int, ...], where: str) -> np.ndarray:
    """Known standard deviations, one per value."""
    sd = np.array(given, dtype=np.float64)
    sd = sd[:, None] if sd.ndim == 1 else sd
    try:
        whole = np.array(np.broadcast_to(sd, shape))
    except ValueError:
        raise InputError(
            f"{where}: sd", f"an array of shape {np.shape(given)}", f"one number, or one for each value: {shape}"
        ) from None
    if not (np.isfinite(whole).all() and (whole > 0.0).all()):
        wrong = np.count_nonzero(~(np.isfinite(whole) & (whole > 0.0)))
        raise InputError(
            f"{where}: sd",
            f"{wrong} of {whole.size} that are not positive and finite",
            "positive standard deviations",
            "A value that is not to count has a large one.",
        )
    whole.setflags(write=False)
    return whole


def _shifted(response: Any, samples: Any) -> Any:
    """M(t − τ) by cubic (Catmull-Rom) interpolation; constant beyond the ends."""
    last = response.shape[0] - 1
    position = jnp.arange(response.shape[0])[:, None] - samples[None, :]
    base = jnp.floor(position)
    f = (position - base)[:, None, :]

    def at(offset: int) -> Any:
        rows = jnp.clip(base.astype(int) + offset, 0, last)
        return jnp.take_along_axis(response, rows[:, None, :], axis=0)

    p0, p1, p2, p3 = at(-1), at(0), at(1), at(2)
    return p1 + 0.5 * f * (p2 - p0 + f * (2 * p0 - 5 * p1 + 4 * p2 - p3 + f * (3 * (p1 - p2) + p3 - p0)))
