"""Smooth maps between ℝᵈ and bounded parameter ranges, coordinate by coordinate, for unconstrained samplers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from structid.core.arrays import Array

POINTS_AT_ONCE = 20_000
"""Number of points that are mapped at once; all draws of a run at once would need many times their own memory."""


class Scatter(NamedTuple):
    """Parameters b_k that are standardised deviations from a mean: the model depends on x_k = μ + d b_k.

    Data determine b_k only through x_k, so a sampler of b_k would have to follow a curved ridge. The coordinates
    therefore describe x_k (the centred form of a hierarchical prior; Papaspiliopoulos et al. 2007,
    doi 10.1214/088342307000000014).
    """

    mean: int  # index of μ among the parameters
    sd: int  # index of d
    members: tuple[int, ...]  # indices of b_k, which are unbounded
    centre: float  # x_k = centre + scale φ_k
    scale: float  # x_k = centre + scale φ_k


class Bijection:
    """Map from ℝᵈ to parameter ranges: logistic for two bounds, exponential for one bound, a scale factor without bounds."""

    def __init__(
        self,
        bounds: Float[np.ndarray, "parameter 2"],
        scales: Sequence[float] | np.ndarray | None = None,
        scatters: Sequence[Scatter] = (),
        logarithmic: Sequence[int] = (),
    ) -> None:
        self.bounds, self.scatters = np.asarray(bounds, dtype=np.float64).reshape(-1, 2), tuple(scatters)
        self.logarithmic = tuple(logarithmic)
        self._walls = self.bounds.copy()  # bounds of the map's image
        self._walls[list(self.logarithmic)] = 0.0, np.inf
        free = ~np.isfinite(self.bounds).any(axis=1)
        self.scales = np.where(free, 1.0 if scales is None else scales, 1.0)
        for scatter in self.scatters:
            self.scales[list(scatter.members)] = 1.0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Bijection) and self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def _numbers(self) -> tuple[Any, ...]:
        """Everything that defines the map."""
        return self.bounds.tobytes(), self.scales.tobytes(), self.scatters, self.logarithmic

    @cached_property
    def _kinds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Masks of coordinates with two bounds, with only a lower bound, and with only an upper bound."""
        has_low, has_high = np.isfinite(self._walls).T
        return has_low & has_high, has_low & ~has_high, has_high & ~has_low

    def forward(self, phi: Float[Array, "... parameter"]) -> tuple[Any, Any]:
        """Map ℝᵈ to the parameter ranges, inside JAX."""
        from structid.engine.device import jnp

        points, jacobian = [], jnp.zeros(phi.shape[:-1])
        for i, ((low, high), scale) in enumerate(zip(self._walls, self.scales, strict=True)):
            point, log_slope = _coordinate(phi[..., i] * scale, low, high)
            points.append(point)
            jacobian = jacobian + log_slope + np.log(scale)
        for mean, sd, members, centre, scale in self.scatters:
            # b_k = (x_k − μ)/d
            for index in members:
                points[index] = (centre + scale * points[index] - points[mean]) / points[sd]
            jacobian = jacobian + len(members) * (np.log(scale) - jnp.log(points[sd]))
        return jnp.stack(points, axis=-1), jacobian

    def __call__(self, phi: Float[np.ndarray, "run parameter"]) -> tuple[np.ndarray, np.ndarray]:
        """Map ℝᵈ to the parameter ranges on the host; ten times as fast as `forward` for few points."""
        if len(phi) <= POINTS_AT_ONCE:
            return self._of_points(phi)
        theta, jacobian = np.empty(phi.shape), np.empty(len(phi))
        for first in range(0, len(phi), POINTS_AT_ONCE):
            some = slice(first, first + POINTS_AT_ONCE)
            theta[some], jacobian[some] = self._of_points(phi[some])
        return theta, jacobian

    def _of_points(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = phi * self.scales
        if not np.isfinite(self.bounds).any():
            return x, np.full(len(phi), np.log(self.scales).sum())
        between, above, below = self._kinds
        low, high = self._walls.T
        theta, log_slope = x.copy(), np.zeros_like(x)
        with np.errstate(over="ignore", invalid="ignore"):
            # Clipped short of the bounds, so that rounding alone gives no point zero density.
            share = np.clip(scipy.special.expit(x[:, between]), np.finfo(float).tiny, 1.0 - np.finfo(float).eps)
            width = high[between] - low[between]
            theta[:, between] = low[between] + width * share
            log_slope[:, between] = np.log(width) - np.logaddexp(0.0, x[:, between]) - np.logaddexp(0.0, -x[:, between])
            theta[:, above], log_slope[:, above] = low[above] + np.exp(x[:, above]), x[:, above]
            theta[:, below], log_slope[:, below] = high[below] - np.exp(x[:, below]), x[:, below]
        jacobian = log_slope.sum(axis=1) + np.log(self.scales).sum()
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            for mean, sd, members, centre, scale in self.scatters:
                # b_k = (x_k − μ)/d
                some = list(members)
                theta[:, some] = (centre + scale * theta[:, some] - theta[:, [mean]]) / theta[:, [sd]]
                jacobian += len(members) * (np.log(scale) - np.log(theta[:, sd]))
        return theta, jacobian

    def inverse(self, theta: Float[np.ndarray, "... parameter"]) -> Float[np.ndarray, "... parameter"]:
        """Map points inside the parameter ranges to ℝᵈ, on the host."""
        between, above, below = self._kinds
        low, high = self._walls.T
        theta = np.asarray(theta, dtype=np.float64)
        x = theta.copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            x[..., between] = scipy.special.logit((theta[..., between] - low[between]) / (high - low)[between])
            x[..., above] = np.log(theta[..., above] - low[above])
            x[..., below] = np.log(high[below] - theta[..., below])
        for mean, sd, members, centre, scale in self.scatters:
            some = list(members)
            x[..., some] = (theta[..., [mean]] + theta[..., [sd]] * theta[..., some] - centre) / scale
        return x / self.scales


def _coordinate(x: Array, low: float, high: float) -> tuple[Array, Array]:
    """Map ℝ to the range of one coordinate, inside JAX; return the value and the logarithm of the slope."""
    import jax

    from structid.engine.device import jnp

    if np.isfinite(low) and np.isfinite(high):
        # Clipped short of the bounds, so that rounding alone gives no point zero density.
        share = jnp.clip(jax.scipy.special.expit(x), np.finfo(float).tiny, 1.0 - np.finfo(float).eps)
        width = high - low
        return low + width * share, -jax.nn.softplus(x) - jax.nn.softplus(-x) + jnp.log(width)
    if np.isfinite(low):
        return low + jnp.exp(x), x
    if np.isfinite(high):
        return high - jnp.exp(x), x
    return x, jnp.zeros_like(x)
