"""Correlation matrices on the host and sums of their derivatives: NumPy for small designs, compiled code for large ones."""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
from jax import lax

from structid.device import jnp
from structid.mechanics.lanes.in_lanes import InLanes
from structid.mechanics.lanes.signals import Signals
from structid.surrogates.kriging.correlations import correlation_of, slopes_of

LARGEST_CALL = 4_000_000
"""Correlations in one call."""

SMALL_DESIGN = 120
"""Points up to which NumPy is quicker than a compiled call, which first has to be compiled for each design."""


class CorrelationMatrices:
    """Correlations of one design's points.

    Parameters
    ----------
    family : str
        The correlation function; see `correlations`.
    separable : bool
        Whether the correlation is a product over the coordinates.
    points : ndarray, shape (point, coordinate)
        The design.
    """

    def __init__(self, family: str, separable: bool, points: np.ndarray) -> None:
        self._form, self._points = (family, separable), np.ascontiguousarray(points)
        self._columns, self._gradients = _compiled(family, separable)

    def __reduce__(self) -> tuple[Any, ...]:
        # A process that is sent a Kriging compiles for itself, or finds what this one compiled on disk.
        return CorrelationMatrices, (*self._form, self._points)

    def with_points(self, others: np.ndarray, log_lengths: np.ndarray) -> np.ndarray:
        """Compute the correlations of the design with other points.

        Parameters
        ----------
        others : ndarray, shape (other, coordinate)
            The other points.
        log_lengths : ndarray, shape (coordinate,)
            Logarithms of the correlation lengths.

        Returns
        -------
        ndarray, shape (point, other)
            Correlations.
        """
        return np.asarray(self._columns(_rows(others, log_lengths), self._points))

    def of(self, log_lengths: np.ndarray) -> np.ndarray:
        """Compute the correlations of the design's points with each other.

        Parameters
        ----------
        log_lengths : ndarray, shape (coordinate,)
            Logarithms of the correlation lengths.

        Returns
        -------
        ndarray, shape (point, point)
            R.
        """
        if len(self._points) <= SMALL_DESIGN:
            return np.asarray(self.of_several(log_lengths[None])[0])
        return self.with_points(self._points, log_lengths)

    def of_several(self, log_lengths: np.ndarray) -> np.ndarray:
        """Compute the correlations of the design's points with each other for several sets of lengths at once.

        Parameters
        ----------
        log_lengths : ndarray, shape (set, coordinate)
            Logarithms of the correlation lengths.

        Returns
        -------
        ndarray, shape (set, point, point)
            R of every set.
        """
        if len(self._points) <= SMALL_DESIGN:
            return np.asarray(correlation_of(*self._form, self._scaled(log_lengths)))
        # One call for several sets: calls of compiled code in a row wait for one another's threads.
        count = max(1, LARGEST_CALL // len(self._points) ** 2)
        parts = []
        for some in (log_lengths[first : first + count] for first in range(0, len(log_lengths), count)):
            rows = np.concatenate([_rows(self._points, one) for one in some])
            columns = np.asarray(self._columns(rows, self._points))
            parts.append(columns.reshape(len(columns), len(some), -1).transpose(1, 0, 2))
        return np.concatenate(parts)

    def _scaled(self, log_lengths: np.ndarray) -> list[np.ndarray]:
        """Differences of the design's points in correlation lengths, of each coordinate (set, point, point)."""
        rates = np.exp(-log_lengths)
        return [rates[:, j, None, None] * self._differences[j] for j in range(self._points.shape[1])]

    @functools.cached_property
    def _differences(self) -> list[np.ndarray]:
        return [column[:, None] - column[None, :] for column in self._points.T]

    def gradient(self, log_lengths: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Differentiate Σᵢⱼ weightᵢⱼ Rᵢⱼ by the logarithms of the correlation lengths.

        Parameters
        ----------
        log_lengths : ndarray, shape (coordinate,)
            The logarithms.
        weights : ndarray, shape (point, point)
            The weights.

        Returns
        -------
        ndarray, shape (coordinate,)
            The gradient.
        """
        if len(self._points) <= SMALL_DESIGN:
            scaled = self._scaled(log_lengths[None])
            slopes = slopes_of(*self._form, scaled, correlation_of(*self._form, scaled))
            return np.array([np.vdot(weights, slope) for slope in slopes])
        slopes = self._gradients(_rows(self._points, log_lengths), self._points, signals=Signals(weights[:, :, None]))
        return np.asarray(slopes.sum(axis=0))


def _rows(points: np.ndarray, log_lengths: np.ndarray) -> np.ndarray:
    return np.hstack([points, np.tile(log_lengths, (len(points), 1))])


@functools.cache
def _compiled(family: str, separable: bool) -> tuple[InLanes, InLanes]:
    """Functions of many points, each with the log lengths in its row: correlations with a design, and derivatives of their sum."""

    def with_one(log_lengths: Any, own: Any, point: Any) -> Any:
        """Correlations of many points, each with lengths of its own, with one."""
        rates = jnp.exp(-log_lengths)
        return correlation_of(family, separable, [(own[:, j] - point[j]) * rates[:, j] for j in range(own.shape[1])])

    # Compiled by itself, so that it is not traced again for every design.
    slopes = jax.jit(jax.grad(lambda *arguments: with_one(*arguments).sum()))

    def columns(rows: Any, points: Any) -> Any:
        own, log_lengths = _halves(rows)
        return lax.scan(lambda _, point: (None, with_one(log_lengths, own, point)), None, points)[1]

    def gradients(rows: Any, signals: Any, points: Any) -> Any:
        own, log_lengths = _halves(rows)

        def step(total: Any, beside: tuple[Any, Any]) -> tuple[Any, None]:
            point, weights = beside
            return total + weights[0][:, None] * slopes(log_lengths, own, point), None

        return lax.scan(step, jnp.zeros_like(log_lengths), (points, signals))[0]

    return InLanes(columns, run_axes=1), InLanes(gradients)


def _halves(rows: Any) -> tuple[Any, Any]:
    """Points and log lengths of some rows."""
    size = rows.shape[1] // 2
    return rows[:, :size], rows[:, size:]
