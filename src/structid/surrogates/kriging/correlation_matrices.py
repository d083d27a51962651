"""Correlation matrices of many points on the host, and sums of their derivatives: compiled once for every design."""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
from jax import lax

from structid.device import jnp
from structid.mechanics.lanes.in_lanes import InLanes
from structid.mechanics.lanes.signals import Signals
from structid.surrogates.kriging.correlations import correlation_of


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
        return self.with_points(self._points, log_lengths)

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
