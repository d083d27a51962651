"""Smooth maps between ℝᵈ and a box, coordinate by coordinate, for samplers that work without bounds."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any

import numpy as np


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

    def inverse(self, theta: np.ndarray) -> np.ndarray:
        """Map the inside of the box to ℝᵈ.

        Parameters
        ----------
        theta : ndarray, shape (..., parameter)
            Points inside the box.

        Returns
        -------
        ndarray, shape (..., parameter)
            Unconstrained coordinates.
        """
        theta = np.asarray(theta, dtype=np.float64)
        columns = [
            np.asarray(transform.inv(theta[..., i])) / scale
            for i, (transform, scale) in enumerate(zip(self._transforms, self.scales, strict=True))
        ]
        return np.stack(columns, axis=-1)

    @property
    def _numbers(self) -> tuple[tuple[tuple[float, float], ...], tuple[float, ...]]:
        """Bounds and scales, which say all of it."""
        return tuple((low, high) for low, high in self.bounds.tolist()), tuple(self.scales.tolist())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Bijection) and self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def _compiled_forward(self) -> Any:
        return _compiled_forward(*self._numbers)

    def __call__(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Map ℝᵈ to the box, on the host.

        Parameters
        ----------
        phi : ndarray, shape (run, parameter)
            Unconstrained coordinates.

        Returns
        -------
        tuple of ndarray
            Points of the box (run, parameter) and the log determinant of the Jacobian (run,).
        """
        if not np.isfinite(self.bounds).any():
            return phi * self.scales, np.full(len(phi), np.log(self.scales).sum())
        theta, jacobian = self._compiled_forward(phi)
        return theta, jacobian


@lru_cache(maxsize=64)
def _compiled_forward(bounds: tuple[tuple[float, float], ...], scales: tuple[float, ...]) -> Any:
    """`Bijection.forward`, compiled once for all bijections of the same box; every round of a calibration makes one."""
    from structid.device import over_runs

    return over_runs(Bijection(np.array(bounds), np.array(scales)).forward, shard=False)
