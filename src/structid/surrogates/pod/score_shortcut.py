"""Likelihoods of measurements in the space of the scores, with sums over time precomputed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from structid.core.arrays import Array
from structid.engine.device import jnp
from structid.engine.matrices.row_by_row import product
from structid.models.traceable import Shortcut
from structid.surrogates.pod.record_fit import RecordFit


class ScoreSource(Protocol):
    """Interface of a response-space surrogate that provides the scores."""

    channels: tuple[str, ...]
    records: dict[str, RecordFit]

    def held_inside(self, theta: Float[Array, "run parameter"]) -> Float[Array, "run parameter"]:
        """Move points beyond the permitted extrapolation to its boundary."""

    def admitted(self, theta: Float[Array, "run parameter"]) -> Bool[Array, " run"]:
        """Return a mask of the points that a posterior may use."""

    def scores_with_deviation(self, fit: RecordFit, theta: Float[Array, "run parameter"]) -> tuple[Any, Any]:
        """Return the scores and their standard deviations."""


@dataclass(frozen=True)
class ScoreShortcut(Shortcut):
    """Measurements in the space of the scores: r = y − ȳ − Φᵀc = beyond − (c − nearest) Φ, with precomputed sums over time."""

    surrogate: ScoreSource  # surrogate that provides the scores
    identity: str  # content hash of the record
    inner: Float[Array, "channel component component"]  # ΦΦᵀ
    left_out: Float[Array, " channel"]  # variance of the omitted components, averaged over time
    samples: Any  # samples of the measurements
    nearest: Float[Array, "channel measurement component"]  # Scores nearest to each measurement
    squares_beyond: Float[Array, "channel measurement"]
    levers_beyond: Float[Array, "channel measurement component"]  # Φ beyond, which is zero up to rounding
    orthogonal: bool = True  # whether ΦΦᵀ is a multiple of the identity, as it is at the samples of the record

    def for_runs(self, measurement: Int[Array, " run"]) -> ScoreShortcut:
        """Assign a separate measurement to each run; see `Shortcut.for_runs`."""
        return replace(
            self,
            nearest=self.nearest[:, measurement],
            squares_beyond=self.squares_beyond[:, measurement],
            levers_beyond=self.levers_beyond[:, measurement],
        )

    def squares(
        self, theta: Float[Array, "run parameter"], coefficients: Float[Array, "channel coefficient run"] | None = None
    ) -> tuple[Any, Any]:
        """Return the sum of squares from the scores: ‖r − Φᵀc‖² = ‖r‖² − 2 cᵀ(Φr) + cᵀ(ΦΦᵀ)c with r = y − ȳ."""
        scores = self._record.scores.predict(self.surrogate.held_inside(theta))
        if coefficients is None:
            squares = self._squares([scores] * self.inner.shape[0])
        else:
            # c₀ (ȳ + Φᵀc) + Σ c_i column_i has the scores c₀ c, c₀, c₁, …
            squares = self._squares([jnp.concatenate([of[:1] * scores.T, of]).T for of in coefficients])
        return squares, jnp.isfinite(squares).all(axis=0) & self.surrogate.admitted(theta)

    @property
    def _record(self) -> RecordFit:
        return self.surrogate.records[self.identity]

    def _squares(self, scores: Sequence[Any]) -> Any:
        """Return ‖r‖² from the scores of each channel, shape (channel, run)."""
        squares = []
        for channel, of_channel in enumerate(scores):
            gap = of_channel - self.nearest[channel]
            reached = product(gap, self.inner[channel]) - 2.0 * self.levers_beyond[channel]
            squares.append(self.squares_beyond[channel] + (reached * gap).sum(axis=1))
        return jnp.stack(squares)

    def _projected(self, scores: Any) -> Any:
        """Return Φ r, shape (channel, run, component)."""
        return self.levers_beyond - (scores - self.nearest) @ self.inner

    def marginal_log_likelihood(
        self, theta: Float[Array, "run parameter"], variance: Float[Array, "channel run"]
    ) -> tuple[Any, Any] | None:
        """Return the log density N(y − ŷ; 0, σ²I + Φᵀ S Φ), marginalised over the score errors, for a surrogate of one channel.

        The modes are orthogonal, ΦΦᵀ = a²I, so the covariance is diagonal in the space of the scores. With the score variances s²
        and p = Φr/a, the variance is σ² + a²s² along each mode and σ² in all other directions. The log density is

            −½ [(T − K) log 2πσ² + Σ log 2π(σ² + a²s²) + (‖r‖² − ‖p‖²)/σ² + Σ p²/(σ² + a²s²)].
        """
        if len(self.surrogate.channels) > 1 or not self.orthogonal:
            return None
        scale = self._record.scale[0]
        scores, deviation = self.surrogate.scores_with_deviation(self._record, theta)
        beyond = variance[0] + self.left_out[0]
        along = beyond[:, None] + (scale * deviation) ** 2
        projected = (self._projected(scores)[0] / scale) ** 2
        along_log = jnp.log(2.0 * jnp.pi * along).sum(axis=1)
        determinant = (self.samples - scores.shape[1]) * jnp.log(2.0 * jnp.pi * beyond) + along_log
        squares = (self._squares([scores])[0] - projected.sum(axis=1)) / beyond + (projected / along).sum(axis=1)
        density = -0.5 * (determinant + squares)
        return density, jnp.isfinite(density) & self.surrogate.admitted(theta)


jax.tree_util.register_dataclass(
    ScoreShortcut,
    data_fields=["inner", "left_out", "samples", "nearest", "squares_beyond", "levers_beyond"],
    meta_fields=["surrogate", "identity", "orthogonal"],
)


def nearest_scores(
    modes: Float[np.ndarray, "component time"],
    inner: Float[np.ndarray, "component component"],
    residual: Float[np.ndarray, " time"],
) -> tuple[np.ndarray, float, np.ndarray]:
    """Split a residual into its projection on the modes and the remainder."""
    # The remainder is kept separate, so that a small misfit keeps its digits.
    nearest = np.linalg.pinv(inner, hermitian=True) @ (modes @ residual)
    beyond = residual - nearest @ modes
    return nearest, beyond @ beyond, modes @ beyond
