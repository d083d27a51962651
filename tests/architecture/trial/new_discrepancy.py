"""A law of somebody else's: independent errors with Laplace's density, which bear outliers."""

from dataclasses import dataclass

import numpy as np

from structid.inference.error_models.base import Discrepancy
from structid.inference.error_models.error_model_kind import ErrorModelKind
from structid.probability.marginals import Uniform


@dataclass(frozen=True, eq=False)
class Laplace(Discrepancy):
    """log p(r) = −log 2b − |r|/b."""

    floor: float = 0.0

    def parameters(self, values, channels, dt, units):
        return {
            f"b_{c}": Uniform(0.0, float(np.abs(values[:, i]).max()), unit=units[i]) for i, c in enumerate(channels)
        }

    def _scales(self, unknown, channels):
        return (
            np.stack([np.asarray(unknown[f"b_{c}"]) for c in channels])
            if isinstance(next(iter(unknown.values())), np.ndarray)
            else self._traced(unknown, channels)
        )

    def _traced(self, unknown, channels):
        from structid.engine.device import jnp

        return jnp.stack([unknown[f"b_{c}"] for c in channels])

    def log_likelihood(self, residual, unknown, channels, dt, white=0.0):
        return self.pointwise(residual, unknown, channels, dt).sum(axis=(0, 1))

    def pointwise(self, residual, unknown, channels, dt):
        from structid.engine.device import jnp

        b = self._scales(unknown, channels)
        return -jnp.log(2.0 * b) - jnp.abs(residual) / b

    def whiten(self, residual, unknown, channels, dt):
        return residual / (np.sqrt(2.0) * self._scales(unknown, channels))

    def draw(self, rng, shape, unknown, channels, dt):
        return rng.laplace(size=shape) * self._scales(unknown, channels).T[:, None, :]

    def describe(self):
        return {"kind": "laplace", "floor": self.floor}


KIND = ErrorModelKind(Laplace, "laplace", {}, {"floor": (float, 0.0)})
