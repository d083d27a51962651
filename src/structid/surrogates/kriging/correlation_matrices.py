"""Correlation matrices on the host, and sums of their derivatives: NumPy for small designs, compiled code for large designs."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from jax import lax
from jaxtyping import Float

from structid.engine.device import jnp
from structid.engine.lanes.in_lanes import InLanes
from structid.engine.lanes.signals import Signals
from structid.surrogates.kriging.correlations import correlation_at, correlation_of, relative_slope

LARGEST_CALL = 4_000_000
"""Number of correlations in one call of compiled code."""

CACHED = 15_000
"""Number of correlations that NumPy computes at once, so that their arrays stay in the cache of a core."""

SMALL_DESIGN = 300
"""Number of points up to which NumPy, with one computation per pair, is faster than compiled code with two per pair."""

DESIGN_STEP = 32
"""Designs are padded to a multiple of this number of points for compiled code, so that few sizes are compiled."""


class CorrelationMatrices:
    """Correlations between the points of one design."""

    def __init__(self, family: str, separable: bool, points: Float[np.ndarray, "point coordinate"]) -> None:
        self._form, self._points = (family, separable), np.ascontiguousarray(points)
        self._columns, self._gradients = _compiled(family, separable)

    def __reduce__(self) -> tuple[Any, ...]:
        # A process that receives a Kriging compiles the code, or loads the code that this process stored on disk.
        return CorrelationMatrices, (*self._form, self._points)

    def with_points(
        self, others: Float[np.ndarray, "other coordinate"], log_lengths: Float[np.ndarray, " coordinate"]
    ) -> Float[np.ndarray, "point other"]:
        """Compute the correlations of the design with other points."""
        return self._by_compiled_code(_rows(others, log_lengths))

    def of(self, log_lengths: Float[np.ndarray, " coordinate"]) -> Float[np.ndarray, "point point"]:
        """Compute the correlations of the design's points with each other."""
        if len(self._points) <= SMALL_DESIGN:
            return self._filled(self._of_pairs(log_lengths[None])[0])
        return self.with_points(self._points, log_lengths)

    def of_several(self, log_lengths: Float[np.ndarray, "set coordinate"]) -> Iterator[np.ndarray]:
        """Compute the correlations of the design's points with each other for several sets of lengths."""
        small, size = len(self._points) <= SMALL_DESIGN, len(self._points)
        # One call handles several sets, because consecutive calls of compiled code wait for each other's threads.
        count = max(1, 2 * CACHED // size**2 if small else LARGEST_CALL // size**2)
        for some in (log_lengths[first : first + count] for first in range(0, len(log_lengths), count)):
            if small:
                yield from map(self._filled, self._of_pairs(some))
            else:
                rows = np.concatenate([_rows(self._points, one) for one in some])
                yield from self._by_compiled_code(rows).reshape(size, len(some), size).transpose(1, 0, 2)

    def _by_compiled_code(self, rows: np.ndarray) -> np.ndarray:
        """Return the correlations (point, row) of the design with points that have their own correlation lengths."""
        missing = -len(self._points) % DESIGN_STEP
        padded = np.concatenate([self._points, np.repeat(self._points[-1:], missing, axis=0)])
        return np.asarray(self._columns(rows, padded)[: len(self._points)])

    def _of_pairs(self, log_lengths: np.ndarray) -> np.ndarray:
        """Return the correlations of all pairs of points (set, pair), in the order of the upper triangle of the matrix."""
        family, separable = self._form
        rates = np.exp(-log_lengths)
        if family == "gaussian" or not separable:
            # A matrix product is avoided, since its last digits would depend on the number of sets.
            scaled = (rate[:, None] * square for rate, square in zip((rates**2).T, self._squares, strict=True))
            return np.asarray(correlation_at(family, sum(scaled)))
        return np.asarray(correlation_of(family, True, list(rates.T[:, :, None] * self._distances[:, None, :])))

    def _filled(self, pairs: np.ndarray) -> np.ndarray:
        """Return the full symmetric matrix from its part above the diagonal."""
        size = len(self._points)
        whole = np.empty(size * size)
        above, below = self._places
        whole[above] = pairs
        whole[below] = pairs
        whole[:: size + 1] = 1.0
        return whole.reshape(size, size)

    @functools.cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions of every pair in the flat matrix, above and below its diagonal."""
        row, column = np.triu_indices(len(self._points), 1)
        return row * len(self._points) + column, column * len(self._points) + row

    @functools.cached_property
    def _distances(self) -> np.ndarray:
        """Pairwise distances in each coordinate, shape (coordinate, pair)."""
        row, column = np.triu_indices(len(self._points), 1)
        return np.asarray(np.abs(self._points[row] - self._points[column]).T.copy())

    @functools.cached_property
    def _squares(self) -> np.ndarray:
        return np.asarray(self._distances**2)

    def gradient(
        self, log_lengths: Float[np.ndarray, " coordinate"], weights: Float[np.ndarray, "point point"]
    ) -> Float[np.ndarray, " coordinate"]:
        """Differentiate Σᵢⱼ weightᵢⱼ Rᵢⱼ with respect to the logarithms of the correlation lengths."""
        if len(self._points) <= SMALL_DESIGN:
            return self._gradient_by_pairs(log_lengths, weights)
        slopes = self._gradients(_rows(self._points, log_lengths), self._points, signals=Signals(weights[:, :, None]))
        return np.asarray(slopes.sum(axis=0))

    def _gradient_by_pairs(self, log_lengths: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the gradient, computed by NumPy: ∂R/∂log ℓⱼ = g sⱼ² R; see `relative_slope`."""
        family, separable = self._form
        both, (above, below) = weights.reshape(-1), self._places
        weighted = (both[above] + both[below]) * self._of_pairs(log_lengths[None])[0]
        rates = np.exp(-2.0 * log_lengths)
        if separable and family != "gaussian":
            scaled = rates[:, None] * self._squares
            return np.array([np.vdot(weighted, relative_slope(family, square) * square) for square in scaled])
        return np.asarray(rates * (self._squares @ (weighted * relative_slope(family, rates @ self._squares))))


def _rows(points: np.ndarray, log_lengths: np.ndarray) -> np.ndarray:
    return np.hstack([points, np.tile(log_lengths, (len(points), 1))])


@functools.cache
def _compiled(family: str, separable: bool) -> tuple[InLanes, InLanes]:
    """Compile two functions of points and log lengths: correlations with a design, and gradients of weighted sums."""

    def with_one(log_lengths: Any, own_lengths: Any, point: Any) -> Any:
        """Return the correlations of one point with many points that have their own correlation lengths."""
        rates = jnp.exp(-log_lengths)
        return correlation_of(
            family, separable, [(own_lengths[:, j] - point[j]) * rates[:, j] for j in range(own_lengths.shape[1])]
        )

    # This part is compiled separately, so that it is not traced again for every design.
    slopes = jax.jit(jax.grad(lambda *arguments: with_one(*arguments).sum()))

    def columns(rows: Any, points: Any) -> Any:
        own_lengths, log_lengths = _halves(rows)
        return lax.scan(lambda _, point: (None, with_one(log_lengths, own_lengths, point)), None, points)[1]

    def gradients(rows: Any, signals: Any, points: Any) -> Any:
        own_lengths, log_lengths = _halves(rows)

        def step(total: Any, own_row: tuple[Any, Any]) -> tuple[Any, None]:
            point, weights = own_row
            return total + weights[0][:, None] * slopes(log_lengths, own_lengths, point), None

        return lax.scan(step, jnp.zeros_like(log_lengths), (points, signals))[0]

    return InLanes(columns, run_axes=1, one_array=True), InLanes(gradients, one_array=True)


def _halves(rows: Any) -> tuple[Any, Any]:
    """Split rows into points and log lengths."""
    size = rows.shape[1] // 2
    return rows[:, :size], rows[:, size:]
