"""Correlated errors in state-space form: a likelihood of cost O(T), by a Kalman filter over all runs at once.

ε_t = s_t + e_t, with white noise e and a stationary Gaussian process s, which is one component of a linear system

    x_{t+1} = F x_t + q_t,   q ~ N(0, P∞ − F P∞ Fᵀ),   s_t = (1, 0, …) x_t

Sampled at a constant step, s has exactly the kernel after which the error model is named (J. Hartikainen & S. Särkkä
2010, doi 10.1109/MLSP.2010.5589113; damped cosine: D. Foreman-Mackey et al. 2017, doi 10.3847/1538-3881/aa9332).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import jax
import numpy as np
from jaxtyping import Bool, Float

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.engine.time_loop import Fold
from structid.inference.error_models.base import Discrepancy, ResidualSample
from structid.inference.error_models.parametric import VARIANCES, Parametric
from structid.probability.truncation import Marginal

Matrix = list[list[Any]]
"""A small matrix whose entries are arrays over channels and runs."""

State = tuple[Any, Any]
"""Mean (component, channel, run) and upper triangle of the covariance (entry, channel, run) of x_t given all earlier samples."""

Step = Callable[..., tuple[State, tuple[Any, Any]]]
"""Maps a state, the current measurements and a mask of them to the next state and to the innovation v with its precision 1/S."""

HUGE = 1e100
"""Unit of a running product of factors from 1 to 1/SMALLEST_WHITE, which may exceed the range of a float."""

SMALLEST_WHITE = 1e-10
"""Share of the correlated variance added to the white variance to keep a smooth process's covariance invertible."""


@dataclass(frozen=True, eq=False)
class Correlated(Parametric):
    """Common part of the correlated error models: a variance, a white variance, and the parameters of a kernel.

    Every parameter is known (a number), has a prior (a Marginal), or is omitted. If omitted, a variance has the prior U(0,
    max|y|²), and a time or frequency has a lognormal prior over the range that the measurement can resolve.
    """

    variance: float | Marginal | None = None  # σ² of the correlated part, in the square of the channel's SI unit
    white: float | Marginal | None = None  # variance of the white part

    kind: ClassVar[str] = "correlated"
    takes_gaps: ClassVar[bool] = True

    @property
    def of_the_model(self) -> Discrepancy:
        """Error model of the correlated part alone."""
        return replace(self, white=0.0)

    # --- properties of a kernel ---------------------------------------------------------------------------------

    @classmethod
    @abstractmethod
    def _shapes(cls) -> tuple[str, ...]:
        """Names of the kernel's parameters besides its variance."""

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        return (*VARIANCES, *cls._shapes())

    @abstractmethod
    def _transition(self, shapes: Mapping[str, Any], dt: float, numpy: Any) -> tuple[Matrix, list[Any]]:
        """F, and the diagonal of P∞ for σ² = 1."""

    # --- the state-space form ------------------------------------------------------------------------------------

    def _system(
        self, unknown: Mapping[str, Any], channels: tuple[str, ...], runs: int, dt: float, numpy: Any
    ) -> tuple[Matrix, Matrix, list[Any], Any]:
        """F, Q, the diagonal of P∞, and the variance of the white noise."""
        values = self._values(unknown, channels, runs, numpy)
        transition, unit = self._transition(values, dt, numpy)
        stationary = [values["variance"] * u for u in unit]
        size = range(len(stationary))
        # Q = P∞ − F P∞ Fᵀ
        noise = [
            [
                (stationary[i] if i == j else 0.0)
                - sum(transition[i][k] * stationary[k] * transition[j][k] for k in size)
                for j in size
            ]
            for i in size
        ]
        return transition, noise, stationary, values["white"] + SMALLEST_WHITE * values["variance"]

    # --- the filter ---------------------------------------------------------------------------------------------

    def _filter(
        self,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        runs: int,
        dt: float,
        more_white: Any = 0.0,
    ) -> tuple[State, Step, Any]:
        """Distribution of x before the first sample, a step of the Kalman filter, and the variance of the first sample.

        A state is the mean of x and the upper triangle of its covariance, each stored as one array. XLA's loops are
        fast over a few large arrays, but slow over many small arrays.
        """
        transition, noise, stationary, white = self._system(unknown, channels, runs, dt, jnp)
        white = white + more_white
        size = range(len(stationary))
        upper = [(i, j) for i in size for j in size if i <= j]
        columns = [jnp.stack([transition[i][k] for i in size]) for k in size]
        shares = [jnp.stack([_share(transition, to, entry) for to in upper]) for entry in upper]
        added = jnp.stack([noise[i][j] for i, j in upper])

        def step(state: State, measured: Any, is_measured: Any = None) -> tuple[State, tuple[Any, Any]]:
            mean, covariance = state
            # v = y − m₀, S = P₀₀ + R; without a measured value, 1/S = 0 and the state is not updated
            error, precision = measured - mean[0], 1.0 / (covariance[0] + white)
            rest = white * precision
            if is_measured is not None:
                precision, rest = jnp.where(is_measured, precision, 0.0), jnp.where(is_measured, rest, 1.0)
            # P − P₀ P₀ᵀ/S; its first row, with which the upper triangle begins, is P₀ R/S
            updated = [
                covariance[at] * rest if i == 0 else covariance[at] - covariance[i] * covariance[j] * precision
                for at, (i, j) in enumerate(upper)
            ]
            # F (m + P₀ v/S), and F (…) Fᵀ + Q
            ahead = sum(columns[k] * (mean[k] + covariance[k] * (error * precision)) for k in size)
            spread = added + sum(share * entry for share, entry in zip(shares, updated, strict=True))
            return (ahead, spread), (error, precision)

        zero = jnp.zeros((len(channels), runs))
        mean = jnp.stack([zero for _ in size])
        covariance = jnp.stack([stationary[i] + zero if i == j else zero for i, j in upper])
        return (mean, covariance), step, stationary[0] + white

    def _innovations(
        self,
        residual: Any,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: np.ndarray | None,
    ) -> tuple[Any, Any]:
        """One-step prediction errors and their precisions, each (time, channel, run); the precision of a missing value is 0."""
        start, step, _ = self._filter(unknown, channels, residual.shape[2], dt)
        filtered: tuple[Any, Any] = jax.lax.scan(
            lambda state, row: step(state, row.residual, row.is_measured), start, _samples(residual, is_measured)
        )[1]
        return filtered

    def log_likelihood(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        white: Any = 0.0,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
    ) -> Float[Array, " run"]:
        """Log density of the whole residual; see `Discrepancy.log_likelihood`."""
        samples = residual.shape[0] if is_measured is None else is_measured.sum(axis=0)[:, None]
        fold: Fold = self._folded(unknown, channels, residual.shape[2], dt, samples, white)
        return fold.of(_samples(residual, is_measured))

    def fold(
        self,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        runs: int,
        dt: float,
        samples: Any,
    ) -> Fold:
        """The log density as a fold over samples; see `Discrepancy.fold`."""
        return self._folded(unknown, channels, runs, dt, samples)

    def _folded(
        self,
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        runs: int,
        dt: float,
        samples: Any,
        more_white: Any = 0.0,
    ) -> Fold:
        start, step, first = self._filter(unknown, channels, runs, dt, more_white)

        def sample(carry: Any, measured: ResidualSample) -> Any:
            # A logarithm costs more than all other operations of a step, so it is taken once, of Π S₁/S in units of HUGE.
            state, squares, product, units = carry
            residual, is_measured, _ = measured
            state, (error, precision) = step(state, residual, is_measured)
            growth = first * precision
            product = product * (growth if is_measured is None else jnp.where(is_measured, growth, 1.0))
            huge = product > HUGE
            product, units = jnp.where(huge, product * (1.0 / HUGE), product), units + huge
            return state, squares + error**2 * precision, product, units

        def log_density(carry: Any) -> Any:
            _, squares, product, units = carry
            # log Π S = T log S₁ − log Π S₁/S
            volume = samples * jnp.log(2.0 * jnp.pi * first) - jnp.log(product) - units * np.log(HUGE)
            return -0.5 * (volume + squares).sum(axis=0)

        nothing = jnp.zeros((len(channels), runs))
        return Fold((start, nothing, nothing + 1.0, nothing), sample, log_density)

    def pointwise(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
    ) -> Float[Array, "time channel run"]:
        """Log density of every value given the earlier values; see `Discrepancy.pointwise`."""
        error, precision = self._innovations(residual, unknown, channels, dt, is_measured)
        if is_measured is not None:
            error, precision = (
                error * is_measured[:, :, None],
                jnp.where(is_measured[:, :, None], precision, 2.0 * jnp.pi),
            )
        return 0.5 * (jnp.log(precision / (2.0 * jnp.pi)) - error**2 * precision)

    def whiten(
        self,
        residual: Float[Array, "time channel run"],
        unknown: Mapping[str, Any],
        channels: tuple[str, ...],
        dt: float,
        is_measured: Bool[np.ndarray, "time channel"] | None = None,
    ) -> Float[Array, "time channel run"]:
        """Innovations over their standard deviation; see `Discrepancy.whiten`."""
        error, precision = self._innovations(residual, unknown, channels, dt, is_measured)
        return error * jnp.sqrt(precision)

    def draw(
        self,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        unknown: Mapping[str, np.ndarray],
        channels: tuple[str, ...],
        dt: float,
    ) -> Float[np.ndarray, "run time channel"]:
        """Draw ε; see `Discrepancy.draw`."""
        runs, samples, _ = shape
        transition, noise, stationary, white = self._system(unknown, channels, runs, dt, np)
        size = range(len(stationary))
        dense = np.array([[np.broadcast_to(noise[i][j], stationary[0].shape) for j in size] for i in size])
        values, vectors = np.linalg.eigh(np.moveaxis(dense, (0, 1), (-2, -1)))
        root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
        state = [np.sqrt(stationary[i]) * rng.standard_normal(stationary[i].shape) for i in size]
        states = np.empty((samples, *stationary[0].shape))
        for t in range(samples):
            states[t] = state[0]
            kick = np.einsum("crij,crj->icr", root, rng.standard_normal((*stationary[0].shape, len(stationary))))
            state = [sum(transition[i][k] * state[k] for k in size) + kick[i] for i in size]
        states += np.sqrt(white) * rng.standard_normal(states.shape)
        return states.transpose(2, 0, 1)


def _samples(residual: Any, is_measured: np.ndarray | None) -> ResidualSample:
    """Rows of a filter."""
    return ResidualSample(residual, None if is_measured is None else is_measured[:, :, None])


def _share(transition: Matrix, to: tuple[int, int], of: tuple[int, int]) -> Any:
    """Contribution of an entry of a symmetric P, and of its mirror entry, to an entry of F P Fᵀ."""
    (i, j), (p, q) = to, of
    share = transition[i][p] * transition[j][q]
    return share if p == q else share + transition[i][q] * transition[j][p]
