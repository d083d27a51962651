"""What a sensor shows of a response: its delay, sampling times, polarity, gain, offset and drift."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from structid.core.arrays import Array
from structid.engine.array_module import namespace
from structid.engine.device import jnp
from structid.sensor_sampling import SensorSampling

DELAY_NODES = 8
"""Number of samples of the polynomial that delays a response by an unknown time shift."""

POLARITIES = {"normal": (1.0,), "reversed": (-1.0,), "unknown": (1.0, -1.0)}
"""Possible signs of a sensor's direction."""


@dataclass(frozen=True, eq=False)
class Instrument:
    """polarity · gain · M(t − time_shift) + offset + drift · t, at the samples of a sensor."""

    channels: tuple[str, ...]
    record_time: Float[np.ndarray, " step"]  # times of the record [s]
    time: Float[np.ndarray, " sample"]  # times of the sensor's samples [s]
    sampling: SensorSampling | None  # None if the sensor has the times of the record
    polarity: str  # a key of POLARITIES
    nuisances: frozenset[str]  # unknown parameters: gain, offset, drift, time_shift
    clock: float  # part of the time shift that the sensor's times already contain [s]

    @property
    def signs(self) -> tuple[float, ...]:
        """Possible signs of the sensor's direction."""
        return POLARITIES[self.polarity]

    def transmitted(
        self, response: Float[Array, "step channel run"], unknown: Mapping[str, Any], sign: Any = None
    ) -> Float[Array, "sample channel run"]:
        """Reading at the samples of the sensor, inside JAX."""
        return self.reading(self.sampled(self.delayed(response, unknown)), unknown, self.time[:, None, None], sign)

    def on_record(
        self, response: Float[Array, "step channel run"], unknown: Mapping[str, Any], sign: Any
    ) -> Float[Array, "step channel run"]:
        """Reading at the samples of the record, inside JAX."""
        return self.reading(self.delayed(response, unknown), unknown, self.record_time[:, None, None], sign)

    def delayed(
        self, response: Float[Array, "step channel run"], unknown: Mapping[str, Any]
    ) -> Float[Array, "step channel run"]:
        """Response delayed by the unknown time shift, inside JAX."""
        if "time_shift" not in self.nuisances:
            return response
        return _delayed(response, (unknown["time_shift"] - self.clock) / (self.record_time[1] - self.record_time[0]))

    def sampled(self, histories: Float[Array, "step *rest"]) -> Float[Array, "sample *rest"]:
        """Histories at the samples of the sensor, inside JAX or of NumPy arrays."""
        return histories if self.sampling is None else self.sampling.apply(histories)

    def reading(self, response: Any, unknown: Mapping[str, Any], time: Any, sign: Any = None) -> Any:
        """Polarity, gain, offset and drift applied to a response (..., channel, run) at some times, inside JAX."""
        if self.polarity != "normal":
            response = response * (self.signs[0] if sign is None else sign)
        if "gain" in self.nuisances:
            response = response * self._of_channels("gain", unknown)
        if "offset" in self.nuisances:
            response = response + self._of_channels("offset", unknown)
        if "drift" in self.nuisances:
            response = response + self._of_channels("drift", unknown) * time
        return response

    def _of_channels(self, kind: str, unknown: Mapping[str, Any]) -> Any:
        """An unknown parameter of each channel, shape (channel, run)."""
        each = [unknown[parameter_name(kind, channel, self.channels)] for channel in self.channels]
        return namespace(each[0]).stack(each)

    # --- as a linear combination --------------------------------------------------------------------------------

    @property
    def _added(self) -> list[str]:
        return [kind for kind in ("offset", "drift") if kind in self.nuisances]

    @property
    def columns(self) -> Float[np.ndarray, "sample channel column"]:
        """What the instrument adds to a response: 1 for an offset, t for a drift."""
        column = {"offset": np.ones(len(self.time)), "drift": self.time}
        columns = np.array([column[kind] for kind in self._added]).reshape(len(self._added), len(self.time)).T
        return np.repeat(columns[:, None, :], len(self.channels), axis=1)

    def coefficients(
        self, unknown: Mapping[str, Any], sign: float, runs: int
    ) -> Float[Array, "channel coefficient run"]:
        """Coefficients of the response and of `columns`, inside JAX."""
        scale = sign * jnp.ones((len(self.channels), runs))
        if "gain" in self.nuisances:
            scale = scale * self._of_channels("gain", unknown)
        return jnp.stack([scale, *(self._of_channels(kind, unknown) for kind in self._added)], axis=1)

    # --- edges of bands, which are not smooth -------------------------------------------------------------------

    def edge_at_samples(self, edge: Float[np.ndarray, "step channel"]) -> Float[np.ndarray, "sample channel"]:
        """Edge of a band at the samples of the sensor, by straight lines."""
        return edge if self.sampling is None else _by_lines(self.time, self.record_time, edge)

    def edge_on_record(self, edge: Float[np.ndarray, "sample channel"]) -> Float[np.ndarray, "step channel"]:
        """Values at the samples of the sensor for those of the record, by straight lines."""
        return edge if self.sampling is None else _by_lines(self.record_time, self.time, edge)


def parameter_name(kind: str, channel: str, channels: tuple[str, ...]) -> str:
    """Name of an instrument parameter of a channel in a posterior."""
    return kind if len(channels) == 1 else f"{kind}_{channel}"


def _by_lines(times: np.ndarray, given: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(times, given, column) for column in values.T], axis=1)


def _delayed(response: Any, samples: Any) -> Any:
    """Return M(t − τ) by polynomials through 8 samples; M is constant beyond the ends."""
    steps, nodes = response.shape[0], range(1 - DELAY_NODES // 2, DELAY_NODES // 2 + 1)
    whole = jnp.floor(-samples)
    fraction = -samples - whole
    rows = jnp.arange(nodes[0], steps + nodes[-1])[:, None] + whole.astype(int)[None, :]
    extended = jnp.take_along_axis(response, jnp.clip(rows, 0, steps - 1)[:, None, :], axis=0)
    total = jnp.zeros(response.shape)
    for first, node in enumerate(nodes):
        # w_j = Π_{i≠j} (f − i)/(j − i)
        weight = math.prod((fraction - other) / (node - other) for other in nodes if other != node)
        total = total + weight * extended[first : first + steps]
    return total
