"""Smooth maps between ℝᵈ and a box, coordinate by coordinate, for samplers that work without bounds."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy


class Bijection:
    """Map from ℝᵈ to a box: logistic for a coordinate with two bounds, exponential for one bound, a scale for none.

    Parameters
    ----------
    bounds : ndarray, shape (parameter, 2)
        Smallest and largest value; infinite for no bound.
    scales : ndarray, shape (parameter,), optional
        Scale of each coordinate without bounds; 1 by default.
    """

    def __init__(self, bounds: np.ndarray, scales: np.ndarray | None = None) -> None:
        self.bounds = np.asarray(bounds, dtype=np.float64).reshape(-1, 2)
        free = ~np.isfinite(self.bounds).any(axis=1)
        self.scales = np.where(free, 1.0 if scales is None else scales, 1.0)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Bijection) and self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def _numbers(self) -> tuple[bytes, bytes]:
        """Bounds and scales, which say all of it."""
        return self.bounds.tobytes(), self.scales.tobytes()

    @cached_property
    def _kinds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which coordinates lie between two bounds, above the only one, and below the only one."""
        has_low, has_high = np.isfinite(self.bounds).T
        return has_low & has_high, has_low & ~has_high, has_high & ~has_low

    @cached_property
    def _transforms(self) -> list[Any]:
        from numpyro.distributions import biject_to, constraints

        def constraint(low: float, high: float) -> Any:
            if np.isfinite(low) and np.isfinite(high):
                return constraints.interval(low, high)
            if np.isfinite(low):
                return constraints.greater_than(low)
            return constraints.less_than(high) if np.isfinite(high) else constraints.real

        return [biject_to(constraint(*bound)) for bound in self.bounds]

    def forward(self, phi: Any) -> tuple[Any, Any]:
        """Map ℝᵈ to the box, inside JAX.

        Parameters
        ----------
        phi : jax.Array, shape (..., parameter)
            Unconstrained coordinates.

        Returns
        -------
        tuple of jax.Array
            Points of the box (..., parameter) and the log determinant of the Jacobian (...).
        """
        from structid.device import jnp

        points, jacobian = [], jnp.zeros(phi.shape[:-1])
        for i, (transform, scale) in enumerate(zip(self._transforms, self.scales, strict=True)):
            x = phi[..., i] * scale
            points.append(transform(x))
            jacobian = jacobian + transform.log_abs_det_jacobian(x, points[-1]) + np.log(scale)
        return jnp.stack(points, axis=-1), jacobian

    def __call__(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Map ℝᵈ to the box, on the host; `forward` without JAX, which would take ten times as long for some points.

        Parameters
        ----------
        phi : ndarray, shape (run, parameter)
            Unconstrained coordinates.

        Returns
        -------
        tuple of ndarray
            Points of the box (run, parameter) and the log determinant of the Jacobian (run,).
        """
        x = phi * self.scales
        if not np.isfinite(self.bounds).any():
            return x, np.full(len(phi), np.log(self.scales).sum())
        between, above, below = self._kinds
        low, high = self.bounds.T
        theta, log_slope = x.copy(), np.zeros_like(x)
        with np.errstate(over="ignore", invalid="ignore"):
            # Short of the bounds, as in NumPyro, so that no point has a density of none by rounding alone.
            share = np.clip(scipy.special.expit(x[:, between]), np.finfo(float).tiny, 1.0 - np.finfo(float).eps)
            width = high[between] - low[between]
            theta[:, between] = low[between] + width * share
            log_slope[:, between] = np.log(width) - np.logaddexp(0.0, x[:, between]) - np.logaddexp(0.0, -x[:, between])
            theta[:, above], log_slope[:, above] = low[above] + np.exp(x[:, above]), x[:, above]
            theta[:, below], log_slope[:, below] = high[below] - np.exp(x[:, below]), x[:, below]
        return theta, log_slope.sum(axis=1) + np.log(self.scales).sum()

    def inverse(self, theta: np.ndarray) -> np.ndarray:
        """Map the inside of the box to ℝᵈ, on the host.

        Parameters
        ----------
        theta : ndarray, shape (..., parameter)
            Points inside the box.

        Returns
        -------
        ndarray, shape (..., parameter)
            Unconstrained coordinates; NaN for a point outside.
        """
        between, above, below = self._kinds
        low, high = self.bounds.T
        theta = np.asarray(theta, dtype=np.float64)
        x = theta.copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            x[..., between] = scipy.special.logit((theta[..., between] - low[between]) / (high - low)[between])
            x[..., above] = np.log(theta[..., above] - low[above])
            x[..., below] = np.log(high[below] - theta[..., below])
        return x / self.scales
