"""Common part of the error models whose errors are independent in time, but not normal, or not of one size."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float

from structid.core.arrays import Array
from structid.engine.array_module import namespace
from structid.engine.device import jnp
from structid.engine.time_loop import Fold
from structid.inference.error_models.base import ResidualSample
from structid.inference.error_models.parametric import Parametric

Density = Callable[[Any, Any], Any]
"""``density(residual, response)``: the log density of values (…, channel, run)."""


class Uncorrelated(Parametric):
    """Common part: one log density for each value, given its residual and the response."""

    takes_gaps: ClassVar[bool] = True

    @abstractmethod
    def density(self, values: Mapping[str, Any], channels: tuple[str, ...], white: Any, numpy: Any) -> Density:
        """Log density of a value for given parameters (channel, run); `white` is an additional variance of normal errors."""

    @abstractmethod
    def sd(self, values: Mapping[str, Any], channels: tuple[str, ...], response: Any, numpy: Any) -> Any:
        """Standard deviation (…, channel, run) of normal errors with as much information on the response."""

    def _of_draws(self, unknown: Mapping[str, Any], channels: tuple[str, ...], runs: int) -> dict[str, np.ndarray]:
        """Every parameter as an array (run, 1, channel), for draws (run, time, channel)."""
        return {name: x.T[:, None, :] for name, x in self._values(unknown, channels, runs, np).items()}

    # --- the likelihood -----------------------------------------------------------------------------------------

    def log_likelihood(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        white: Any = 0.0,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
        response: Float[Array, "time channel run"] | None = None,
    ) -> Float[Array, " run"]:
        """Log density of the whole residual; see `Discrepancy.log_likelihood`."""
        return self._each(residual, unknown, channels, white, is_measured, response).sum(axis=(0, 1))

    def pointwise(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
        response: Float[Array, "time channel run"] | None = None,
    ) -> Float[Array, "time channel run"]:
        """Log density of every value; see `Discrepancy.pointwise`."""
        return self._each(residual, unknown, channels, 0.0, is_measured, response)

    def _each(
        self, residual: Any, unknown: Any, channels: Any, white: Any, is_measured: np.ndarray | None, response: Any
    ) -> Any:
        """Log density of every value, 0 where it is missing."""
        numpy = namespace(residual)
        values = self._values(unknown, channels, residual.shape[2], numpy)
        # A point on the edge of its prior may have zero variance; its density is −inf or NaN, and NumPy would warn.
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            density = self.density(values, channels, white, numpy)(residual, response)
        return density if is_measured is None else numpy.where(is_measured[:, :, None], density, 0.0)

    def fold(
        self,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        runs: int,
        dt: float,
        samples: Any,
    ) -> Fold:
        """The log density as a fold over samples; see `Discrepancy.fold`."""
        density = self.density(self._values(unknown, channels, runs, jnp), channels, 0.0, jnp)

        def step(total: Any, sample: ResidualSample) -> Any:
            each = density(sample.residual, sample.response)
            return total + (each if sample.is_measured is None else jnp.where(sample.is_measured, each, 0.0))

        return Fold(jnp.zeros((len(channels), runs)), step, lambda total: total.sum(axis=0))

    def whiten(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
        response: Float[Array, "time channel _"] | None = None,
    ) -> Float[Array, "time channel run"]:
        """Divide by `sd`; see `Discrepancy.whiten`."""
        numpy = namespace(residual)
        return residual / self.sd(self._values(unknown, channels, residual.shape[2], numpy), channels, response, numpy)
